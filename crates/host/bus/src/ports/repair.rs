//! Decides when failed connections of a port are retried.
//!
//! iceoryx2 tries to connect to a port once, and again whenever the service's list of ports has
//! changed (#129). Most failures are those of a port that is being removed because its process
//! died. It leaves the list next, and nothing needs to be done. Retried are connections to ports
//! still listed three seconds later, because file descriptors or memory were short.

/// Duration of a failure until it is retried, and the period of further retries, ns. Ports of dead
/// processes are searched for once a second by every member, and on a busy machine later.
const RETRY_EVERY_NS: u64 = 3_000_000_000;

/// Failures and retries of a port. Times are monotonic ns.
#[derive(Debug, Default)]
pub(crate) struct Repair {
    /// Number of failed connections at the last check.
    seen: u64,
    /// Time of the next retry. None if all connections are established.
    retry_from_ns: Option<u64>,
}

impl Repair {
    /// True if connections are to be retried now. Then call [`Self::retried`]. Only after a failure
    /// the clock is read, and `is_listed` asked whether a failed port still exists.
    pub(crate) fn is_due(
        &mut self,
        failed: u64,
        now_ns: impl FnOnce() -> u64,
        is_listed: impl FnOnce() -> bool,
    ) -> bool {
        if failed == self.seen && self.retry_from_ns.is_none() {
            return false;
        }
        self.seen = failed;
        let now_ns = now_ns();
        let next_ns = now_ns.saturating_add(RETRY_EVERY_NS);
        if now_ns < *self.retry_from_ns.get_or_insert(next_ns) {
            return false;
        }
        self.retry_from_ns = is_listed().then_some(next_ns);
        self.retry_from_ns.is_some()
    }

    /// Records the number of failed connections after a retry, and whether it has established all.
    pub(crate) const fn retried(&mut self, failed: u64, is_whole: bool) {
        self.seen = failed;
        if is_whole {
            self.retry_from_ns = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = RETRY_EVERY_NS;

    /// A port of which connections have failed `failed` times, at a time. `listed` is the
    /// state of the failed ports.
    fn is_due(repair: &mut Repair, failed: u64, now_ns: u64, listed: bool) -> bool {
        repair.is_due(failed, || now_ns, || listed)
    }

    #[test]
    fn without_a_failure_neither_the_clock_nor_the_list_is_read() {
        let mut repair = Repair::default();
        assert!(!repair.is_due(0, || unreachable!(), || unreachable!()));
        assert!(!is_due(&mut repair, 1, 0, true));
        assert!(is_due(&mut repair, 1, PERIOD, true));
        repair.retried(1, true);
        assert!(!repair.is_due(1, || unreachable!(), || unreachable!()));
    }

    #[test]
    fn a_failed_port_that_is_gone_when_a_retry_is_due_is_not_retried() {
        let mut repair = Repair::default();
        for failure in 1..=3 {
            let begin_ns = failure * 10 * PERIOD;
            for now_ns in [begin_ns, begin_ns + 1, begin_ns + PERIOD - 1] {
                assert!(!repair.is_due(failure, || now_ns, || unreachable!()));
            }
            assert!(!is_due(&mut repair, failure, begin_ns + PERIOD, false));
            assert!(!repair.is_due(failure, || unreachable!(), || unreachable!()));
        }
    }

    #[test]
    fn a_failed_port_that_is_still_there_is_retried_once_a_period() {
        let mut repair = Repair::default();
        assert!(!is_due(&mut repair, 1, 0, true));
        for period in 1..=3 {
            let now_ns = period * PERIOD;
            assert!(!is_due(&mut repair, period, now_ns - 1, true));
            assert!(is_due(&mut repair, period, now_ns, true));
            repair.retried(period + 1, false);
            assert!(!is_due(&mut repair, period + 1, now_ns, true));
        }
        assert!(is_due(&mut repair, 4, 4 * PERIOD, true));
        repair.retried(4, true);
        assert!(!is_due(&mut repair, 5, 6 * PERIOD, true), "a new failure");
        assert!(is_due(&mut repair, 5, 7 * PERIOD, true));
    }
}
