//! A file that is being checked, and its problems.

use std::fmt::Display;
use std::path::PathBuf;

use joulebus_config::Problem;
use toml::Spanned;

/// Range of the times that a key may give, s.
const HOLDS_S: (f64, f64) = (0.01, 3_600.0);

/// The text of a file, with the problems found so far.
pub(super) struct Check<'a> {
    pub(super) file: String,
    pub(super) folder: PathBuf,
    pub(super) text: &'a str,
    pub(super) fleet: &'a str,
    pub(super) problems: Vec<Problem>,
}

impl Check<'_> {
    /// A time in ns, or 0 and a problem.
    pub(super) fn nanoseconds(&mut self, key: &str, found_s: f64) -> u64 {
        let (least, most) = HOLDS_S;
        if !(least <= found_s && found_s <= most) {
            let what = format!("is {found_s} s");
            self.problem(None, key, what, &format!("Allowed: {least} to {most} s"));
            return 0;
        }
        (found_s * 1e9) as u64
    }

    /// The value of a check, or a problem of the key at its position.
    pub(super) fn checked<T, E: Display>(
        &mut self,
        place: &Spanned<String>,
        key: &str,
        result: Result<T, E>,
    ) -> Option<T> {
        result
            .map_err(|error| {
                let start = Some(place.span().start).filter(|_| !place.span().is_empty());
                let what = format!("= {:?} {error}", place.get_ref());
                self.problem(start, key, what, "docs/reference/bridge-file.md has examples");
            })
            .ok()
    }

    /// Adds a problem at the byte `at` of the text. Without `at` it belongs to the line that sets
    /// the last part of `key`, if there is one.
    pub(super) fn problem(&mut self, at: Option<usize>, key: &str, what: String, remedy: &str) {
        let place = (self.file.as_str(), self.text);
        Problem::add(&mut self.problems, place, at, key, what, remedy);
    }
}
