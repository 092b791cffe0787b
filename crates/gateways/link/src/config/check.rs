//! A file that is being checked, beyond its single keys.

use std::path::PathBuf;

use joulebus_config::{Config, Problem, Section, Text};

use crate::protocol::selection::{MAX_RANGES, Selection};

/// Maximum size of a certificate or key, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// A file that is being checked, and its problems.
pub(super) struct Check {
    pub(super) problems: Vec<Problem>,
}

impl Check {
    pub(super) fn add(&mut self, problem: Problem) {
        problem.add_to(&mut self.problems);
    }

    /// A readable file, relative to the link's file.
    pub(super) fn file(&mut self, text: &Text, is_secret: bool) -> PathBuf {
        let path = text.file();
        let read = if is_secret {
            joulebus_files::read_secret(&path, MAX_FILE_BYTES).map(drop)
        } else {
            joulebus_files::read_to_string(&path, MAX_FILE_BYTES).map(drop)
        };
        if let Err(error) = read {
            let remedy = "docs/how-to/hosts.md has the command that makes the fleet's certificates";
            self.add(text.problem(&format!("cannot be read: {error}"), remedy));
        }
        path
    }

    /// The robots of a section. Without a list all robots are selected.
    pub(super) fn robots(&mut self, section: &Section<'_>, config: &Config) -> Selection {
        let ranges = section.robots("robots");
        let is_set = ranges.is_some();
        let ranges: Vec<(u32, u32)> =
            ranges.into_iter().flatten().map(|ids| (*ids.start(), *ids.end())).collect();
        let (found, most) = (ranges.len(), MAX_RANGES);
        if found > most || is_set && found == 0 {
            let what = format!("has {found} entries, allowed are 1 to {most}");
            let remedy = "Join neighbouring ids, or leave the key out for all";
            self.add(section.problem("robots", what, remedy));
        }
        let known = |(first, last): &(u32, u32)| {
            let platforms = &config.settings().platforms;
            let mut ids = platforms.iter().flat_map(|platform| &platform.robots);
            ids.any(|ids| ids.start() <= last && first <= ids.end())
        };
        if let Some((first, last)) = ranges.iter().find(|range| !known(range)) {
            let what = format!("names {first}-{last}, which no platform has");
            let remedy = "Name robots of `platform.robots` in the fleet's config";
            self.add(section.problem("robots", what, remedy));
        }
        Selection::new(u32::MAX, 1, ranges)
    }
}
