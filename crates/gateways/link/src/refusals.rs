//! Counters of refused messages by reason. The first of each reason is logged.

use std::collections::BTreeMap;
use std::fmt::Display;

/// Number of refusals by reason.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
#[serde(transparent)]
pub(crate) struct Refusals(BTreeMap<&'static str, u64>);

impl Refusals {
    /// Counts a refusal. Logs the first of its reason, with the sender.
    pub(crate) fn count(&mut self, reason: &'static str, from: &str, error: &dyn Display) {
        let count = self.0.entry(reason).or_default();
        *count += 1;
        if *count == 1 {
            tracing::warn!("refused what came from {from}: {error}. Further ones are only counted");
        }
    }

    pub(crate) fn add(&mut self, other: &Self) {
        for (reason, count) in other.iter() {
            *self.0.entry(reason).or_default() += count;
        }
    }

    pub(crate) fn total(&self) -> u64 {
        self.0.values().sum()
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        self.0.iter().map(|(reason, count)| (*reason, *count))
    }
}
