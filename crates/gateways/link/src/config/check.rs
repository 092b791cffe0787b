//! A file that is being checked, and its problems.

use std::path::PathBuf;

use joulebus_config::Problem;

/// A file that is being checked.
pub(super) struct Check<'a> {
    pub(super) file: String,
    pub(super) folder: PathBuf,
    pub(super) text: &'a str,
    pub(super) problems: Vec<Problem>,
}

impl Check<'_> {
    /// A problem of `key`, at byte `at` or in the line that sets it.
    pub(super) fn problem(&mut self, at: Option<usize>, key: &str, what: String, remedy: &str) {
        let place = (self.file.as_str(), self.text);
        Problem::add(&mut self.problems, place, at, key, what, remedy);
    }
}
