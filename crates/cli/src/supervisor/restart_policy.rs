//! What is to be done with a process, and when. Pure: time comes as an argument.

/// First rest before a restart, ns. Faster crash loops than this break iceoryx2.
const FIRST_REST_NS: u64 = 100_000_000;
/// Longest rest, ns.
const LONGEST_REST_NS: u64 = 5_000_000_000;
/// A run as long as this was healthy: the next rest is the first one again, ns.
const HEALTHY_RUN_NS: u64 = 10_000_000_000;

/// Where a process stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// It runs.
    Running { since_ns: u64 },
    /// It has ended unasked and is to start again.
    Resting { until_ns: u64 },
    /// It has been asked to end.
    Ending { kill_at_ns: u64 },
    /// It has been killed.
    Killed,
    /// It has ended, and stays so.
    Over,
}

/// What to do now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// Nothing.
    Nothing,
    /// Start it.
    Start,
    /// Kill it: it was asked to end and has not.
    Kill,
}

/// The policy of one process that is to run until it is asked to end.
#[derive(Debug, Clone)]
pub(super) struct RestartPolicy {
    phase: Phase,
    rest_ns: u64,
}

impl RestartPolicy {
    /// Of a process that is to start at once.
    pub(super) const fn new(now_ns: u64) -> Self {
        Self {
            phase: Phase::Resting { until_ns: now_ns },
            rest_ns: FIRST_REST_NS,
        }
    }

    /// It has been started.
    pub(super) const fn started(&mut self, now_ns: u64) {
        self.phase = Phase::Running { since_ns: now_ns };
    }

    /// It has ended, or could not be started. Returns how long it rests before the next start, ns;
    /// none if it was asked to end.
    pub(super) fn ended(&mut self, now_ns: u64) -> Option<u64> {
        let run_ns = match self.phase {
            Phase::Running { since_ns } => now_ns.saturating_sub(since_ns),
            Phase::Resting { .. } => 0,
            Phase::Ending { .. } | Phase::Killed | Phase::Over => {
                self.phase = Phase::Over;
                return None;
            }
        };
        if run_ns >= HEALTHY_RUN_NS {
            self.rest_ns = FIRST_REST_NS;
        }
        let rest_ns = self.rest_ns;
        self.rest_ns = (2 * rest_ns).min(LONGEST_REST_NS);
        self.phase = Phase::Resting {
            until_ns: now_ns + rest_ns,
        };
        Some(rest_ns)
    }

    /// It is asked to end, and killed when it still runs after `grace_ns`.
    pub(super) const fn ask_to_end(&mut self, now_ns: u64, grace_ns: u64) {
        self.phase = match self.phase {
            Phase::Running { .. } => Phase::Ending {
                kill_at_ns: now_ns + grace_ns,
            },
            Phase::Resting { .. } => Phase::Over,
            other => other,
        };
    }

    /// What to do at `now_ns`.
    pub(super) const fn step(&mut self, now_ns: u64) -> Step {
        match self.phase {
            Phase::Resting { until_ns } if now_ns >= until_ns => Step::Start,
            Phase::Ending { kill_at_ns } if now_ns >= kill_at_ns => {
                self.phase = Phase::Killed;
                Step::Kill
            }
            _ => Step::Nothing,
        }
    }

    /// Whether it runs and nobody has asked it to end.
    pub(super) const fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running { .. })
    }

    /// Whether it has ended for good.
    pub(super) const fn is_over(&self) -> bool {
        matches!(self.phase, Phase::Over)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_crash_loop_rests_twice_as_long_each_time_up_to_the_longest() {
        let mut policy = RestartPolicy::new(0);
        let mut now_ns = 0;
        for want_ms in [100, 200, 400, 800, 1600, 3200, 5000, 5000] {
            assert_eq!(policy.step(now_ns), Step::Start);
            policy.started(now_ns);
            assert_eq!(policy.step(now_ns), Step::Nothing);
            now_ns += 7 * MS;
            assert_eq!(policy.ended(now_ns), Some(want_ms * MS), "{want_ms}");
            assert_eq!(policy.step(now_ns + want_ms * MS - 1), Step::Nothing);
            now_ns += want_ms * MS;
        }
    }

    #[test]
    fn the_rest_after_a_run() {
        // Runs before the last one that failed at once, length of the last run, rest after it.
        for (failed, run_ms, want_ms) in [
            (0, 0, 100),
            (1, 9_999, 200),
            (3, 9_999, 800),
            (3, 10_000, 100),
            (9, 60_000, 100),
        ] {
            let mut policy = RestartPolicy::new(0);
            for _ in 0..failed {
                policy.started(0);
                policy.ended(0);
            }
            policy.started(0);
            let rest = policy.ended(run_ms * MS);
            assert_eq!(rest, Some(want_ms * MS), "{failed} failed, {run_ms} ms");
        }
    }

    #[test]
    fn a_start_that_fails_counts_as_a_run_of_no_length() {
        let mut policy = RestartPolicy::new(0);
        assert_eq!(policy.ended(0), Some(100 * MS));
        assert_eq!(policy.step(100 * MS), Step::Start);
        assert_eq!(policy.ended(100 * MS), Some(200 * MS));
    }

    #[test]
    fn who_is_asked_to_end_is_killed_once_after_the_grace_time_and_never_restarted() {
        let mut policy = RestartPolicy::new(0);
        policy.started(0);
        policy.ask_to_end(10, 5);
        policy.ask_to_end(14, 5);
        assert!(!policy.is_running() && !policy.is_over());
        assert_eq!(policy.step(14), Step::Nothing);
        assert_eq!(policy.step(15), Step::Kill);
        assert_eq!(policy.step(16), Step::Nothing);
        assert_eq!(policy.ended(17), None);
        assert!(policy.is_over());
        assert_eq!(policy.step(u64::MAX), Step::Nothing);
    }

    #[test]
    fn who_rests_when_asked_to_end_does_not_start_again() {
        let mut policy = RestartPolicy::new(0);
        policy.started(0);
        policy.ended(1);
        policy.ask_to_end(2, 5);
        assert!(policy.is_over());
        assert_eq!(policy.step(u64::MAX), Step::Nothing);
    }
}
