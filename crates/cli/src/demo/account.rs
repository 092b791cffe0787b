//! Accounts for every sample sent. Pure.

use std::collections::BTreeMap;

use joulebus_wire::DropCounts;
use serde::Serialize;

/// The samples of a demo.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct DemoCounts {
    /// Samples sent by the source.
    pub(crate) sent: u64,
    /// Samples that the worker accepted.
    pub(crate) accepted: u64,
    /// Samples that it dropped, by reason.
    pub(crate) dropped: BTreeMap<&'static str, u64>,
    /// Sent minus accounted for: 0 unless something is wrong.
    pub(crate) difference: i128,
}

impl DemoCounts {
    pub(super) fn new(sent: u64, accepted: u64, dropped: DropCounts) -> Self {
        let difference = i128::from(sent) - i128::from(accepted) - i128::from(dropped.total());
        let dropped = dropped.iter().map(|(reason, count)| (reason.name(), count)).collect();
        Self { sent, accepted, dropped, difference }
    }

    /// True if every sample is accounted for.
    pub(crate) const fn adds_up(&self) -> bool {
        self.difference == 0
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::DropReason;

    use super::*;

    #[test]
    fn it_adds_up_if_each_sample_was_accepted_or_dropped_for_a_reason() {
        use DropReason::{Backlog, BeforeJoin};
        for (accepted, drops, difference) in [
            (100, vec![], 0),
            (80, vec![(Backlog, 10), (BeforeJoin, 10)], 0),
            (99, vec![], 1),
            (101, vec![], -1),
            (90, vec![(Backlog, 9)], 1),
            (0, vec![], 100),
        ] {
            let mut dropped = DropCounts::default();
            drops.iter().for_each(|(reason, count)| dropped.add(*reason, *count));
            let account = DemoCounts::new(100, accepted, dropped);
            assert_eq!(account.difference, difference, "{accepted} {drops:?}");
            assert_eq!(account.adds_up(), difference == 0);
            let named: Vec<_> = drops.iter().map(|(reason, _)| reason.name()).collect();
            assert!(account.dropped.keys().eq(&named), "{account:?}");
        }
    }
}
