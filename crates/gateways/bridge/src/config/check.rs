//! A file that is being checked, beyond its single keys.

use std::fmt::Display;
use std::time::Duration;

use joulebus_config::{Problem, Section, Text};

/// A file that is being checked, and its problems.
pub(super) struct Check<'a> {
    pub(super) fleet: &'a str,
    pub(super) problems: Vec<Problem>,
}

impl Check<'_> {
    pub(super) fn add(&mut self, problem: Problem) {
        problem.add_to(&mut self.problems);
    }

    /// The value of a check, or a problem of the text.
    pub(super) fn checked<T, E: Display>(
        &mut self,
        text: &Text,
        result: Result<T, E>,
    ) -> Option<T> {
        let add = |error: E| {
            self.add(
                text.problem(&error.to_string(), "docs/reference/bridge-file.md has examples"),
            );
        };
        result.map_err(add).ok()
    }

    /// A time between messages.
    pub(super) fn every(section: &Section<'_>, key: &str, usual_s: f64) -> Duration {
        Duration::from_secs_f64(section.number(key).unwrap_or(usual_s))
    }
}
