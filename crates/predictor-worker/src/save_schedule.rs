//! Schedule of the ledger's saves: a kill at any time loses at most the configured time. Pure.

/// Determines the time of the next save from the duration of the last one.
#[derive(Debug, Clone)]
pub(crate) struct SaveSchedule {
    every_ns: u64,
    /// Time of the last saved state, monotonic ns.
    saved_ns: u64,
    next_ns: u64,
}

impl SaveSchedule {
    /// Starts at `now_ns`. The saved state must not become older than `every_ns`.
    pub(crate) const fn new(every_ns: u64, now_ns: u64) -> Self {
        Self { every_ns, saved_ns: now_ns, next_ns: now_ns.saturating_add(every_ns / 2) }
    }

    /// Start time of the next save, monotonic ns.
    pub(crate) const fn next_ns(&self) -> u64 {
        self.next_ns
    }

    /// Records a save, successful or not, of the state at `of_ns`, which took from `begun_ns` to
    /// `ended_ns`. Returns the age of the previously saved state just before, if it exceeded the
    /// limit, ns.
    ///
    /// The next save begins early enough to take twice as long as this one, with a quarter of the
    /// interval as a reserve for scheduling delays, and not so early that saves follow without a
    /// pause.
    pub(crate) fn tried(
        &mut self,
        of_ns: u64,
        (begun_ns, ended_ns): (u64, u64),
        is_saved: bool,
    ) -> Option<u64> {
        let took_ns = ended_ns.saturating_sub(begun_ns);
        let exposed_ns = ended_ns.saturating_sub(self.saved_ns);
        if is_saved {
            self.saved_ns = of_ns;
        }
        let within_ns = (self.every_ns / 4 * 3).saturating_sub(took_ns.saturating_mul(2));
        let pause_ns = (self.every_ns / 8).max(took_ns);
        self.next_ns = of_ns.saturating_add(within_ns).max(ended_ns.saturating_add(pause_ns));
        (exposed_ns > self.every_ns).then_some(exposed_ns)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    proptest! {
        #[test]
        fn no_more_than_promised_is_lost_while_saves_take_an_eighth_and_waking_up_another(
            every_ns in 50_000_000..3_600 * SECOND_NS,
            saves in prop::collection::vec((0u64..=1_000, 0u64..=1_000, 0u64..=1_000), 1..60),
        ) {
            let mut schedule = SaveSchedule::new(every_ns, 0);
            let mut saved_ns = 0;
            for (late, took, age) in saves {
                let share = |of: u64, parts: u64| every_ns / 1_000 * of / parts;
                // The saved frame was sent at most a fiftieth of the interval before it is read.
                let begun_ns = schedule.next_ns() + share(late, 8);
                let of_ns = begun_ns - share(age, 50).min(begun_ns);
                let ended_ns = begun_ns + share(took, 8);
                prop_assert!(ended_ns - saved_ns <= every_ns, "{} ns", ended_ns - saved_ns);
                prop_assert_eq!(schedule.tried(of_ns, (begun_ns, ended_ns), true), None);
                saved_ns = of_ns;
            }
        }
    }

    #[test]
    fn a_late_save_is_reported_with_the_time_at_risk() {
        let mut schedule = SaveSchedule::new(SECOND_NS, 0);
        let at = schedule.next_ns();
        assert_eq!(at, SECOND_NS / 2);
        let slow = (at, 3 * SECOND_NS);
        assert_eq!(schedule.tried(at, slow, true), Some(3 * SECOND_NS));
        let next = schedule.next_ns();
        assert!(next > 3 * SECOND_NS, "never without a pause");
        // The save failed: the saved state grows older.
        let refused = schedule.tried(next, (next, next), false);
        assert_eq!(refused, Some(next - at));
        let again = schedule.next_ns();
        assert!(again > next && again <= next + SECOND_NS, "a refused save is tried again");
        assert_eq!(schedule.tried(again, (again, again), true), Some(again - at));
        let next = schedule.next_ns();
        assert_eq!(schedule.tried(next, (next, next), true), None, "in time again");
    }
}
