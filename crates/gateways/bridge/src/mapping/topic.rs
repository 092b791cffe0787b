//! Topic patterns: levels between slashes, one of which may contain `{robot}`.

/// Maximum length of a topic, bytes. MQTT allows 65,535.
const MAX_BYTES: usize = 512;
const WILDCARD: &str =
    "has a wildcard beside other letters, a # that is not last, or a control character";
pub(crate) const ROBOT: &str = "{robot}";

/// A pattern to read: it matches topics and extracts the robot's name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pattern {
    /// `$share/GROUP/` of a shared subscription, which no message's topic has.
    share: String,
    levels: Vec<String>,
}

impl Pattern {
    /// Parses `fleet/{robot}/power`. `+` and `#` are MQTT's wildcards.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        check(text)?;
        let behind = text.strip_prefix("$share/").and_then(|rest| rest.split_once('/'));
        let is_group = |group: &str| !group.is_empty() && !group.contains(['+', '#', '{']);
        let (share, text) = match behind {
            Some((group, rest)) if is_group(group) && !rest.is_empty() => {
                (format!("$share/{group}/"), rest)
            }
            _ if text.starts_with("$share") => {
                return Err("is no shared subscription: allowed is $share/GROUP/ before the topic"
                    .to_owned());
            }
            _ => (String::new(), text),
        };
        let levels: Vec<String> = text.split('/').map(str::to_owned).collect();
        let last = levels.len() - 1;
        let is_bad = |(place, level): (usize, &String)| match level.as_str() {
            "+" => false,
            "#" => place != last,
            other => other.contains(['+', '#']),
        };
        if levels.iter().enumerate().any(is_bad) {
            return Err(WILDCARD.to_owned());
        }
        Ok(Self { share, levels })
    }

    pub(crate) fn has_robot(&self) -> bool {
        self.levels.iter().any(|level| level.contains(ROBOT))
    }

    pub(crate) fn filter(&self) -> String {
        let levels = self.levels.iter().map(|level| {
            let is_named = level.contains(ROBOT);
            if is_named { "+" } else { level }
        });
        self.share.clone() + &levels.collect::<Vec<_>>().join("/")
    }

    /// `Some` if the topic matches, with the robot's name if the pattern has it.
    pub(crate) fn matches<'t>(&self, topic: &'t str) -> Option<Option<&'t str>> {
        let mut robot = None;
        let mut rest = topic.split('/');
        for level in &self.levels {
            if level == "#" {
                return Some(robot);
            }
            let found = rest.next()?;
            match level.split_once(ROBOT) {
                Some((before, after)) => {
                    let name = found.strip_prefix(before)?.strip_suffix(after)?;
                    robot = Some(name);
                }
                None if level == "+" || level == found => {}
                None => return None,
            }
        }
        rest.next().is_none().then_some(robot)
    }
}

/// A topic to write, with `{robot}` and `{fleet}`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Template(String);

impl Template {
    /// Parses `joulebus/{fleet}/{robot}/budget`. `of_robot` states that `{robot}` is required, else
    /// it is forbidden.
    pub(crate) fn parse(text: &str, fleet: &str, of_robot: bool) -> Result<Self, String> {
        check(text)?;
        if text.contains(['+', '#']) {
            return Err("has a wildcard, which a topic to write to must not have".to_owned());
        }
        match (text.contains(ROBOT), of_robot) {
            (false, true) => Err("lacks {robot}: what is written to it is of one robot".to_owned()),
            (true, false) => {
                Err("has {robot}, but what is written to it is not of one robot".to_owned())
            }
            _ => Ok(Self(text.replace("{fleet}", fleet))),
        }
    }

    pub(crate) fn of(&self, robot: &str) -> String {
        self.0.replace(ROBOT, robot)
    }
}

fn check(text: &str) -> Result<(), String> {
    if !(1..=MAX_BYTES).contains(&text.len()) {
        return Err(format!("has {} bytes, allowed are 1 to {MAX_BYTES}", text.len()));
    }
    if text.matches(ROBOT).count() > 1 {
        return Err("has {robot} more than once".to_owned());
    }
    if text.contains(char::is_control) {
        return Err(WILDCARD.to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use joulebus_testkit::{assert_contains, cases};
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_pattern_finds_the_robot_in_topics_that_match() {
        for case in cases(
            r#"
            fleet/{robot}/power | fleet/+/power | fleet/a/power | Some(Some("a"))
            fleet/{robot}/power | fleet/+/power | fleet/a/powers | None
            fleet/{robot}/power | fleet/+/power | fleet/a/b/power | None
            fleet/{robot}/power | fleet/+/power | fleet/a | None
            x/agv-{robot}-s/y | x/+/y | x/agv-07-s/y | Some(Some("07"))
            x/agv-{robot}-s/y | x/+/y | x/lift-07-s/y | None
            +/{robot}/# | +/+/# | a/b/c/d | Some(Some("b"))
            +/{robot}/# | +/+/# | a/b | Some(Some("b"))
            all | all | all | Some(None)
            $share/g/fleet/{robot}/power | $share/g/fleet/+/power | fleet/a/power | Some(Some("a"))
            $share/g/all | $share/g/all | $share/g/all | None
            {robot} | + |  | Some(Some(""))
            "#,
        ) {
            let [pattern, filter, topic, found] = case.as_slice() else {
                panic!("{case:?}");
            };
            let read = Pattern::parse(pattern).unwrap();
            assert_eq!(&read.filter(), filter);
            assert_eq!(&format!("{:?}", read.matches(topic)), found, "{pattern} {topic}");
        }
    }

    #[test]
    fn patterns_that_no_broker_takes_are_refused() {
        for (text, why) in [
            ("", "has 0 bytes, allowed are 1 to 512"),
            ("a/#/b", WILDCARD),
            ("a/b+", WILDCARD),
            ("a/b#", WILDCARD),
            ("a/{robot}+", WILDCARD),
            ("a\0", WILDCARD),
            ("{robot}/{robot}", "more than once"),
        ] {
            assert_contains(&Pattern::parse(text).unwrap_err(), [why]);
        }
        for (text, of_robot, why) in [
            ("a/+", false, "must not have"),
            ("a", true, "lacks {robot}"),
            ("a/{robot}", false, "not of one robot"),
        ] {
            assert_contains(&Template::parse(text, "lab", of_robot).unwrap_err(), [why]);
        }
        let topic = Template::parse("jb/{fleet}/{robot}/b", "lab", true).unwrap();
        assert_eq!(topic.of("r7"), "jb/lab/r7/b");
    }

    proptest! {
        #[test]
        fn what_is_written_for_a_robot_is_read_as_that_robot(
            before in "[a-z/]{0,8}",
            after in "[a-z/]{0,8}",
            name in "[a-zA-Z0-9_. -]{1,12}",
        ) {
            let text = format!("{before}/x{{robot}}y/{after}");
            let topic = Template::parse(&text, "f", true).unwrap().of(&name);
            let pattern = Pattern::parse(&text).unwrap();
            prop_assert_eq!(pattern.matches(&topic), Some(Some(name.as_str())));
        }

        #[test]
        fn no_topic_panics(pattern in ".{0,24}", topic in ".{0,40}") {
            if let Ok(pattern) = Pattern::parse(&pattern) {
                let _ = (pattern.matches(&topic), pattern.filter());
            }
        }
    }
}
