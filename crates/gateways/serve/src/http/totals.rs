//! Counters that never fall while this program runs, although workers restart and robots leave.

use std::collections::HashMap;

use joulebus_board::{Board, Counted};
use joulebus_wire::{DropCounts, QueryCounts, budget_flag};

/// Maximum number of robots whose ledger is remembered after they have left.
const MAX_ROBOTS: usize = 65_536;

/// Counters of a fleet.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Accumulated {
    pub(super) ticks: u64,
    pub(super) ticks_skipped: u64,
    pub(super) ticks_late: u64,
    pub(super) samples_accepted: u64,
    pub(super) samples_dropped: DropCounts,
    pub(super) queries: QueryCounts,
    /// Energy that the robots have consumed, µJ.
    pub(super) consumed_uj: u64,
    pub(super) tick: Counted,
    pub(super) latency: Counted,
}

/// A robot's ledger as it was last seen.
#[derive(Debug, Clone, Copy, Default)]
struct Ledger {
    metered_ns: u64,
    /// The highest value that it has counted, µJ. Energy that is fed back does not reduce
    /// consumption.
    most_uj: i64,
    /// Energy by this ledger and its predecessors, µJ.
    consumed_uj: u64,
}

/// Adds up what ledgers count, which begin again at 0 with another ledger.
#[derive(Debug, Default)]
pub(super) struct Accumulator {
    ledgers: HashMap<u32, Ledger>,
    consumed_uj: u64,
    queries: QueryCounts,
    /// Counters of earlier runs of workers.
    queries_before: QueryCounts,
}

impl Accumulator {
    /// Adds the contents of a board. [`Accumulator::consumed_uj`] is then up to date.
    pub(super) fn add(&mut self, board: &Board) -> Accumulated {
        for (robot, row) in &board.rows {
            let ledger = row.budget.filter(|budget| budget.flags & budget_flag::LEDGER != 0);
            if let Some(budget) = ledger {
                self.drawn(*robot, budget.metered_ns, budget.drawn_uj);
            }
        }
        if self.ledgers.len() > MAX_ROBOTS {
            self.ledgers.retain(|robot, _| board.rows.contains_key(robot));
        }
        let (ticks, ticks_skipped, ticks_late) = board.ticks();
        Accumulated {
            ticks,
            ticks_skipped,
            ticks_late,
            samples_accepted: board.accepted(),
            samples_dropped: board.dropped(),
            queries: self.queried(board.queries.unwrap_or_default()),
            consumed_uj: self.consumed_uj,
            tick: board.stages.compute_counted,
            latency: board.stages.total_counted,
        }
    }

    fn drawn(&mut self, robot: u32, metered_ns: u64, drawn_uj: i64) {
        let ledger = self.ledgers.entry(robot).or_default();
        if metered_ns < ledger.metered_ns {
            // Another ledger.
            ledger.most_uj = 0;
        }
        let more_uj = drawn_uj.saturating_sub(ledger.most_uj).max(0);
        ledger.metered_ns = metered_ns;
        ledger.most_uj += more_uj;
        let more_uj = more_uj.unsigned_abs();
        ledger.consumed_uj = ledger.consumed_uj.saturating_add(more_uj);
        self.consumed_uj = self.consumed_uj.saturating_add(more_uj);
    }

    /// Energy that a robot has consumed, µJ, if it has or had a ledger.
    pub(super) fn consumed_uj(&self, robot: u32) -> Option<u64> {
        Some(self.ledgers.get(&robot)?.consumed_uj)
    }

    fn queried(&mut self, newest: QueryCounts) -> QueryCounts {
        let mut counts = newest.refused.iter().zip(&self.queries.refused);
        let is_another = newest.answered < self.queries.answered
            || counts.any(|(newest, before)| newest < before);
        if is_another {
            self.queries_before = sum(self.queries_before, self.queries);
        }
        self.queries = newest;
        sum(self.queries_before, newest)
    }
}

fn sum(mut counts: QueryCounts, more: QueryCounts) -> QueryCounts {
    counts.answered += more.answered;
    for (sum, more) in counts.refused.iter_mut().zip(more.refused) {
        *sum += more;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ledger_that_begins_again_adds_what_it_counts() {
        let mut accumulator = Accumulator::default();
        for (robot, metered_ns, drawn_uj, its_uj, total_uj) in [
            (1, 100, 10, 10, 10),
            (2, 100, 5, 5, 15),
            (1, 200, 12, 12, 17),
            // Gives 2 µJ back, and takes 3.
            (1, 300, 10, 12, 17),
            (1, 400, 13, 13, 18),
            (1, 50, 3, 16, 21),
            (2, 200, 6, 6, 22),
            (3, 10, -5, 0, 22),
        ] {
            accumulator.drawn(robot, metered_ns, drawn_uj);
            assert_eq!(accumulator.consumed_uj(robot), Some(its_uj));
            assert_eq!(accumulator.consumed_uj, total_uj);
        }
        assert_eq!(accumulator.consumed_uj(4), None);
    }

    #[test]
    fn questions_of_another_worker_are_added() {
        let mut accumulator = Accumulator::default();
        for (answered, total) in [(3, 3), (7, 7), (1, 8), (2, 9), (0, 9)] {
            let counts = QueryCounts { answered, ..QueryCounts::default() };
            assert_eq!(accumulator.queried(counts).answered, total);
        }
    }

    #[test]
    fn refusals_do_not_fall_when_a_worker_that_answered_nothing_is_restarted() {
        let mut accumulator = Accumulator::default();
        for (full, late, expected) in
            [(2, 0, [2, 0]), (5, 1, [5, 1]), (0, 0, [5, 1]), (1, 3, [6, 4])]
        {
            let mut counts = QueryCounts::default();
            counts.refused[..2].copy_from_slice(&[full, late]);
            assert_eq!(accumulator.queried(counts).refused[..2], expected);
        }
    }
}
