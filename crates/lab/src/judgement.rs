//! Whether recordings are plausible, asked before they are used.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use anyhow::bail;
use joulebus_dataset::inspect::{Implausible, Limits, judge};
use joulebus_dataset::trial::Trial;
use joulebus_eval::score::Recording;
use joulebus_plausibility::{Kind, Quantity, Severity};
use joulebus_program::output::say;
use serde::Serialize;

/// Findings that the user lets through.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct AcceptArguments {
    /// Findings to let through, because you know better: sign, unit, clock, hold, never-came, range, saturation,
    /// constant
    #[arg(long, value_name = "FINDING,…", value_delimiter = ',')]
    pub(crate) accept: Vec<Kind>,
}

/// Implausible readings of one kind, in any number of recordings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Judged {
    /// Recordings that show it.
    pub(crate) recordings: usize,
    /// Whether the user lets it through.
    pub(crate) accepted: bool,
    /// The first.
    #[serde(flatten)]
    pub(crate) first: Implausible,
}

impl Judged {
    fn is_error(&self) -> bool {
        self.first.finding.is_error() && !self.accepted
    }

    fn line(&self) -> String {
        let mut line = format!("{}: {}", self.first.finding.kind, self.first.place);
        if self.recordings > 1 {
            // Writing to a String cannot fail.
            let _ = write!(line, " (and in {} other recordings)", self.recordings - 1);
        }
        line
    }
}

impl AcceptArguments {
    /// Shows what is implausible in trials, and refuses errors.
    ///
    /// # Errors
    /// A finding that makes results wrong and is not accepted.
    pub(crate) fn judge<'a>(
        &self,
        trials: impl IntoIterator<Item = &'a Trial>,
    ) -> anyhow::Result<Vec<Judged>> {
        let found = trials.into_iter().map(|trial| judge(trial, &Limits::default()));
        self.settle(found)
    }

    /// The same of recordings, which were judged when they were opened.
    ///
    /// # Errors
    /// As [`AcceptArguments::judge`].
    pub(crate) fn recordings<'a>(
        &self,
        recordings: impl IntoIterator<Item = &'a Recording>,
    ) -> anyhow::Result<Vec<Judged>> {
        let found = recordings.into_iter();
        self.settle(found.map(|recording| recording.implausible().to_vec()))
    }

    fn settle(&self, found: impl Iterator<Item = Vec<Implausible>>) -> anyhow::Result<Vec<Judged>> {
        let judged = self.gather(found);
        let (errors, others): (Vec<_>, Vec<_>) = judged.into_iter().partition(Judged::is_error);
        for finding in &others {
            let word = if finding.accepted { "accepted" } else { "warning" };
            say(&format!("{word}: {}", finding.line()));
        }
        if errors.is_empty() {
            return Ok(others);
        }
        let lines: Vec<String> = errors.iter().map(Judged::line).collect();
        bail!("implausible readings: nothing was done\n  {}", lines.join("\n  "))
    }

    /// One line of each kind and quantity, errors first.
    fn gather(&self, found: impl Iterator<Item = Vec<Implausible>>) -> Vec<Judged> {
        type Key = (Severity, Kind, Option<Quantity>);
        let mut judged: BTreeMap<Key, Judged> = BTreeMap::new();
        for first in found.flatten() {
            let finding = &first.finding;
            let accepted = self.accept.contains(&finding.kind);
            let key = (finding.severity, finding.kind, finding.quantity);
            let entry = judged.entry(key).or_insert(Judged {
                recordings: 0,
                accepted,
                first,
            });
            entry.recordings += 1;
        }
        judged.into_values().collect()
    }
}
