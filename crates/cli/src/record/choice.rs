//! Selection of topics.

use joulebus_capture_format::MessageKind;
use joulebus_program::exit::UsageError;
use regex::Regex;

/// A selection of topics. All by default.
#[derive(Debug)]
pub(super) struct TopicChoice {
    topics: Vec<String>,
    regex: Option<Regex>,
}

impl TopicChoice {
    pub(super) fn new(topics: &[String], regex: Option<&str>) -> Result<Self, UsageError> {
        let kinds = MessageKind::of_fleet();
        let known: Vec<&str> = kinds.map(|kind| kind.name()).collect();
        let stranger =
            topics.iter().find(|topic| !topic.contains('/') && !known.contains(&topic.as_str()));
        if let Some(stranger) = stranger {
            return Err(UsageError(format!(
                "--topics {stranger}: no such service, there are {}",
                known.join(", ")
            )));
        }
        let regex = regex.map(Regex::new).transpose();
        Ok(Self {
            topics: topics.to_vec(),
            regex: regex.map_err(|error| UsageError(format!("--regex: {error}")))?,
        })
    }

    /// Refuses a topic or an expression that none of these fleets' topics is or matches.
    pub(super) fn check(&self, fleets: &[&str]) -> Result<(), UsageError> {
        let of_fleet = |fleet| MessageKind::of_fleet().map(move |kind| kind.topic(fleet, 0));
        let there: Vec<String> = fleets.iter().copied().flat_map(of_fleet).collect();
        let is_there = |topic: &&String| !topic.contains('/') || there.contains(topic);
        let what = match (self.topics.iter().find(|topic| !is_there(topic)), &self.regex) {
            (Some(topic), _) => format!("--topics {topic}: no such topic"),
            (None, Some(regex)) if !there.iter().any(|topic| regex.is_match(topic)) => {
                format!("--regex {regex}: matches no topic")
            }
            _ => return Ok(()),
        };
        let there = there.join(", ");
        let remedy = "those of single robots need --per-robot";
        Err(UsageError(format!("{what}, there are {there}: {remedy}")))
    }

    /// True if the topic is selected. A service name selects that service of any fleet.
    pub(super) fn has(&self, topic: &str) -> bool {
        if self.topics.is_empty() && self.regex.is_none() {
            return true;
        }
        let service = service(topic);
        let named = |wanted: &String| wanted == topic || service == Some(wanted.as_str());
        let matches = |regex: &Regex| regex.is_match(topic);
        self.topics.iter().any(named) || self.regex.as_ref().is_some_and(matches)
    }
}

/// The service in `joulebus/<fleet>/<service>`.
fn service(topic: &str) -> Option<&str> {
    let mut parts = topic.split('/');
    match (parts.next(), parts.next(), parts.next(), parts.next()) {
        (Some("joulebus"), Some(_), Some(service), None) => Some(service),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn services_topics_and_expressions_select() {
        let all = ["joulebus/lab/samples", "joulebus/yard/ticks", "joulebus/lab/robot/3/forecast"];
        for (topics, regex, chosen) in [
            (vec![], None, vec![0, 1, 2]),
            (vec!["samples"], None, vec![0]),
            (vec!["joulebus/yard/ticks"], None, vec![1]),
            (vec!["forecasts"], None, vec![]),
            (vec![], Some("/robot/3/"), vec![2]),
            (vec!["ticks"], Some("^joulebus/lab/"), vec![0, 1, 2]),
        ] {
            let topics: Vec<String> = topics.into_iter().map(str::to_owned).collect();
            let choice = TopicChoice::new(&topics, regex).unwrap();
            let found: Vec<usize> = (0..all.len()).filter(|at| choice.has(all[*at])).collect();
            assert_eq!(found, chosen, "{topics:?} {regex:?}");
        }
    }

    #[test]
    fn what_no_topic_of_the_fleets_is_or_matches_is_refused_with_those_that_there_are() {
        for (topics, regex, refused) in [
            (vec![], None, false),
            (vec!["ticks"], Some("^joulebus/(lab|yard)/sam"), false),
            (vec!["joulebus/yard/ticks"], None, false),
            (vec!["joulebus/lab/samples", "joulebus/lob/ticks"], None, true),
            (vec!["joulebus/lab/robot/3/forecast"], None, true),
            (vec!["ticks"], Some("forecasts$|^x"), false),
            (vec!["ticks"], Some("forecast$"), true),
        ] {
            let topics: Vec<String> = topics.into_iter().map(str::to_owned).collect();
            let checked = TopicChoice::new(&topics, regex).unwrap().check(&["lab", "yard"]);
            let result = checked.map_err(|error| error.to_string());
            assert_eq!(result.is_err(), refused, "{topics:?} {regex:?} {result:?}");
            assert!(result.is_ok() || result.unwrap_err().contains("joulebus/yard/queries"));
        }
    }

    #[test]
    fn a_service_that_does_not_exist_is_refused_with_those_that_do() {
        let error = TopicChoice::new(&["sample".to_owned()], None).unwrap_err();
        assert!(error.to_string().contains("samples, forecasts"), "{error}");
        assert!(TopicChoice::new(&[], Some("(")).is_err());
    }
}
