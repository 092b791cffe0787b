//! Accounts for every sample sent. Pure.

use std::collections::BTreeMap;

use joulebus_wire::{DropCounts, DropReason};
use serde::Serialize;

/// Samples of one run of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SourceRun {
    pub(super) epoch: u64,
    pub(super) sent: u64,
    /// Additional samples that it may have sent: it was killed before it could report.
    pub(super) unsure: u64,
}

/// Last counters of one run of a worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct WorkerAccount {
    pub(super) accepted: u64,
    pub(super) dropped: DropCounts,
    /// Run of the source of its first samples. `None` without samples.
    pub(super) first_source_epoch: Option<u64>,
}

/// Sums over all runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Account {
    /// Samples sent, by the source's report. For a killed source, as far as observed.
    pub(crate) sent: u64,
    /// Samples accepted, by all workers.
    pub(crate) accepted: u64,
    /// Samples dropped, by reason, by all workers.
    pub(crate) dropped: BTreeMap<&'static str, u64>,
    /// Samples sent while no worker ran, or taken by one that was killed before it reported.
    pub(crate) lost_between_workers: u64,
    /// Sent minus accounted for: 0 unless something is wrong.
    pub(crate) difference: i128,
    /// Samples that killed sources may have sent unobserved: the allowed deviation of `difference`
    /// from 0.
    pub(crate) uncertain: u64,
}

impl Account {
    /// Computes the sums. Oldest runs first.
    ///
    /// A worker counts samples sent before it joined as `BeforeJoin`, including those that an
    /// earlier worker had accepted. So with several workers that reason is not usable: the loss
    /// between them is the remainder, and only the *last* worker must account for all samples since
    /// the source's run that it received first.
    pub(super) fn new(sources: &[SourceRun], workers: &[WorkerAccount]) -> Self {
        let sent: u64 = sources.iter().map(|run| run.sent).sum();
        let accepted: u64 = workers.iter().map(|run| run.accepted).sum();
        let mut dropped = BTreeMap::new();
        for (reason, count) in workers.iter().flat_map(|run| run.dropped.iter().collect::<Vec<_>>())
        {
            if reason != DropReason::BeforeJoin || workers.len() == 1 {
                *dropped.entry(reason.name()).or_default() += count;
            }
        }
        let counted = accepted + dropped.values().sum::<u64>();
        let lost_between_workers = if workers.len() > 1 { sent.saturating_sub(counted) } else { 0 };
        let overall = i128::from(sent) - i128::from(counted) - i128::from(lost_between_workers);
        let last = workers.last().map_or(overall, |last| difference(sources, last));
        Self {
            sent,
            accepted,
            dropped,
            lost_between_workers,
            difference: if overall == 0 { last } else { overall },
            uncertain: sources.iter().map(|run| run.unsure).sum(),
        }
    }

    /// True if every sample is accounted for.
    pub(crate) fn adds_up(&self) -> bool {
        self.difference.unsigned_abs() <= u128::from(self.uncertain)
    }
}

/// Samples sent to the worker since the first run that it received, minus those it accounts for.
fn difference(sources: &[SourceRun], worker: &WorkerAccount) -> i128 {
    let Some(first) = worker.first_source_epoch else {
        // It has received nothing, and accounts for nothing.
        return 0;
    };
    let sent: u64 = sources.iter().filter(|run| run.epoch >= first).map(|run| run.sent).sum();
    i128::from(sent) - i128::from(worker.accepted) - i128::from(worker.dropped.total())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(epoch: u64, sent: u64) -> SourceRun {
        SourceRun { epoch, sent, unsure: 0 }
    }

    fn worker(accepted: u64, drops: &[(DropReason, u64)], first: u64) -> WorkerAccount {
        let mut dropped = DropCounts::default();
        for (reason, count) in drops {
            dropped.add(*reason, *count);
        }
        WorkerAccount { accepted, dropped, first_source_epoch: Some(first) }
    }

    #[test]
    fn one_worker_and_one_source() {
        use DropReason::{Backlog, BeforeJoin};
        for (accepted, drops, difference) in [
            (100, vec![], 0),
            (90, vec![(Backlog, 10)], 0),
            (80, vec![(Backlog, 10), (BeforeJoin, 10)], 0),
            (99, vec![], 1),
            (101, vec![], -1),
            (90, vec![(Backlog, 9)], 1),
        ] {
            let account = Account::new(&[source(1, 100)], &[worker(accepted, &drops, 1)]);
            assert_eq!(account.difference, difference, "{accepted} {drops:?}");
            assert_eq!(account.adds_up(), difference == 0);
            assert_eq!(account.lost_between_workers, 0);
        }
    }

    #[test]
    fn a_worker_that_received_nothing_of_what_was_sent_does_not_add_up() {
        let deaf = WorkerAccount { first_source_epoch: None, ..worker(0, &[], 0) };
        assert!(!Account::new(&[source(1, 5)], &[deaf]).adds_up());
        assert!(!Account::new(&[source(1, 5)], &[]).adds_up());
        assert!(Account::new(&[], &[deaf]).adds_up());
    }

    #[test]
    fn a_killed_workers_losses_are_what_the_others_do_not_report() {
        use DropReason::{Backlog, BeforeJoin};
        // 40 reported by the first, 10 lost with it or after it, 50 reported by the second.
        let killed = worker(38, &[(Backlog, 2)], 1);
        let second = worker(50, &[(BeforeJoin, 50)], 1);
        let account = Account::new(&[source(1, 100)], &[killed, second]);
        assert_eq!(account.lost_between_workers, 10);
        assert_eq!((account.accepted, account.difference), (88, 0));
        assert_eq!(account.dropped, BTreeMap::from([("Backlog", 2)]));
        // The second one has lost a sample without reporting it.
        let forgetful = worker(49, &[(BeforeJoin, 50)], 1);
        assert_eq!(Account::new(&[source(1, 100)], &[killed, forgetful]).difference, 1);
        // Both accept the same samples.
        let greedy = worker(100, &[], 1);
        assert!(!Account::new(&[source(1, 100)], &[killed, greedy]).adds_up());
    }

    #[test]
    fn a_killed_source_is_known_up_to_one_frame() {
        let killed = SourceRun { unsure: 20, ..source(1, 80) };
        let sources = [killed, source(2, 40)];
        assert!(Account::new(&sources, &[worker(140, &[], 1)]).adds_up());
        assert!(!Account::new(&sources, &[worker(141, &[], 1)]).adds_up());
        // A worker started after it is not affected.
        let late = Account::new(&sources, &[worker(60, &[], 1), worker(40, &[], 2)]);
        assert_eq!((late.difference, late.lost_between_workers), (0, 20));
    }
}
