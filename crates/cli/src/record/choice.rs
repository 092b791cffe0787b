//! Selection of topics.

use joulebus_capture::MessageKind;
use joulebus_program::exit::UsageError;
use regex::Regex;

/// A selection of topics; all by default.
#[derive(Debug)]
pub(super) struct TopicChoice {
    topics: Vec<String>,
    regex: Option<Regex>,
}

impl TopicChoice {
    pub(super) fn new(topics: &[String], regex: Option<&str>) -> Result<Self, UsageError> {
        let known = MessageKind::OF_FLEET.map(MessageKind::name);
        let stranger = topics
            .iter()
            .find(|topic| !topic.contains('/') && !known.contains(&topic.as_str()));
        if let Some(stranger) = stranger {
            return Err(UsageError(format!(
                "--topics {stranger}: no such service; there are {}",
                known.join(", ")
            )));
        }
        let regex = regex.map(Regex::new).transpose();
        Ok(Self {
            topics: topics.to_vec(),
            regex: regex.map_err(|error| UsageError(format!("--regex: {error}")))?,
        })
    }

    /// Whether the topic is selected. A service name selects that service of any fleet.
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
        let all = [
            "joulebus/lab/samples",
            "joulebus/yard/ticks",
            "joulebus/lab/robot/3/forecast",
        ];
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
    fn a_service_that_does_not_exist_is_refused_with_those_that_do() {
        let error = TopicChoice::new(&["sample".to_owned()], None).unwrap_err();
        assert!(error.to_string().contains("samples, forecasts"), "{error}");
        assert!(TopicChoice::new(&[], Some("(")).is_err());
    }
}
