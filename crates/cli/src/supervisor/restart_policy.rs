//! When a process is started, restarted and killed. Pure: time is an argument.

/// First backoff before a restart, ns. Faster crash loops break iceoryx2.
const FIRST_BACKOFF_NS: u64 = 100_000_000;
/// Maximum backoff, ns.
const MAX_BACKOFF_NS: u64 = 5_000_000_000;
/// After a run of this length the backoff is the first one again, ns.
const HEALTHY_RUN_NS: u64 = 10_000_000_000;

/// State of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// The process runs.
    Running { since_ns: u64 },
    /// The process exited unexpectedly and is due to restart.
    Waiting { until_ns: u64 },
    /// The process was asked to stop.
    Stopping { kill_at_ns: u64 },
    /// The process was killed.
    Killed,
    /// The process has exited and is not restarted.
    Stopped,
}

/// The next action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    Nothing,
    Start,
    /// Kill it: it was asked to stop and still runs.
    Kill,
}

/// Restart policy of one process.
#[derive(Debug, Clone)]
pub(super) struct RestartPolicy {
    phase: Phase,
    backoff_ns: u64,
}

impl RestartPolicy {
    /// The policy of a process that starts at once.
    pub(super) const fn new(now_ns: u64) -> Self {
        Self { phase: Phase::Waiting { until_ns: now_ns }, backoff_ns: FIRST_BACKOFF_NS }
    }

    pub(super) const fn started(&mut self, now_ns: u64) {
        self.phase = Phase::Running { since_ns: now_ns };
    }

    /// The process exited or could not be started. Returns the backoff before the next start, ns.
    /// None if it was asked to stop.
    pub(super) fn ended(&mut self, now_ns: u64) -> Option<u64> {
        let run_ns = match self.phase {
            Phase::Running { since_ns } => now_ns.saturating_sub(since_ns),
            Phase::Waiting { .. } => 0,
            Phase::Stopping { .. } | Phase::Killed | Phase::Stopped => {
                self.phase = Phase::Stopped;
                return None;
            }
        };
        if run_ns >= HEALTHY_RUN_NS {
            self.backoff_ns = FIRST_BACKOFF_NS;
        }
        let backoff_ns = self.backoff_ns;
        self.backoff_ns = (2 * backoff_ns).min(MAX_BACKOFF_NS);
        self.phase = Phase::Waiting { until_ns: now_ns + backoff_ns };
        Some(backoff_ns)
    }

    /// The process was asked to stop. It is killed if it still runs after `grace_ns`.
    pub(super) const fn request_stop(&mut self, now_ns: u64, grace_ns: u64) {
        self.phase = match self.phase {
            Phase::Running { .. } => Phase::Stopping { kill_at_ns: now_ns + grace_ns },
            Phase::Waiting { .. } => Phase::Stopped,
            other => other,
        };
    }

    /// The action at `now_ns`.
    pub(super) const fn step(&mut self, now_ns: u64) -> Step {
        match self.phase {
            Phase::Waiting { until_ns } if now_ns >= until_ns => Step::Start,
            Phase::Stopping { kill_at_ns } if now_ns >= kill_at_ns => {
                self.phase = Phase::Killed;
                Step::Kill
            }
            _ => Step::Nothing,
        }
    }

    /// True if it runs and was not asked to stop.
    pub(super) const fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running { .. })
    }

    /// True if it has exited for good.
    pub(super) const fn is_stopped(&self) -> bool {
        matches!(self.phase, Phase::Stopped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn the_backoff_doubles_in_a_crash_loop_up_to_the_maximum() {
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
    fn backoff_after_a_run() {
        // Runs before the last one that failed at once, length of the last run, backoff after it.
        for (failed, run_ms, want_ms) in
            [(0, 0, 100), (1, 9_999, 200), (3, 9_999, 800), (3, 10_000, 100), (9, 60_000, 100)]
        {
            let mut policy = RestartPolicy::new(0);
            for _ in 0..failed {
                policy.started(0);
                policy.ended(0);
            }
            policy.started(0);
            let backoff = policy.ended(run_ms * MS);
            assert_eq!(backoff, Some(want_ms * MS), "{failed} failed, {run_ms} ms");
        }
    }

    #[test]
    fn a_failed_start_counts_as_a_run_of_length_0() {
        let mut policy = RestartPolicy::new(0);
        assert_eq!(policy.ended(0), Some(100 * MS));
        assert_eq!(policy.step(100 * MS), Step::Start);
        assert_eq!(policy.ended(100 * MS), Some(200 * MS));
    }

    #[test]
    fn a_process_asked_to_stop_is_killed_once_after_the_grace_time_and_not_restarted() {
        let mut policy = RestartPolicy::new(0);
        policy.started(0);
        policy.request_stop(10, 5);
        policy.request_stop(14, 5);
        assert!(!policy.is_running() && !policy.is_stopped());
        assert_eq!(policy.step(14), Step::Nothing);
        assert_eq!(policy.step(15), Step::Kill);
        assert_eq!(policy.step(16), Step::Nothing);
        assert_eq!(policy.ended(17), None);
        assert!(policy.is_stopped());
        assert_eq!(policy.step(u64::MAX), Step::Nothing);
    }

    #[test]
    fn a_process_asked_to_stop_during_the_backoff_is_not_restarted() {
        let mut policy = RestartPolicy::new(0);
        policy.started(0);
        policy.ended(1);
        policy.request_stop(2, 5);
        assert!(policy.is_stopped());
        assert_eq!(policy.step(u64::MAX), Step::Nothing);
    }
}
