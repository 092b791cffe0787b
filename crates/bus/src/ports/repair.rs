//! Decides when a port is recreated, and when its failure is an error.

/// Minimum interval between two recreations of a port, ns; a failure that lasts longer is an error.
const RENEW_EVERY_NS: u64 = 1_000_000_000;
/// The same while there is no port, ns.
const RETRY_EVERY_NS: u64 = 20_000_000;

/// Meaning of a port's count of failed connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Look {
    /// No new failures.
    Whole,
    /// A connection has failed: recreate the port and receive again.
    Renew,
    /// Connections still fail one second after the first failure.
    Failing {
        /// Connections failed since the port was opened.
        connections: u64,
    },
}

/// Failures and recreations of a port. Times are monotonic ns.
#[derive(Debug, Default)]
pub(crate) struct Repair {
    /// Number of failed connections at the last check.
    seen: u64,
    /// True if a connection has failed since the port was created.
    broken: bool,
    /// Time of the first failure.
    failing_since_ns: Option<u64>,
    /// Earliest time of the next recreation.
    renew_from_ns: u64,
}

impl Repair {
    /// True if the port is to be recreated now. The clock is read only after a failure.
    pub(crate) fn is_due(&mut self, now_ns: impl FnOnce() -> u64) -> bool {
        if !self.broken {
            return false;
        }
        let now_ns = now_ns();
        if now_ns < self.renew_from_ns {
            return false;
        }
        self.renew_from_ns = now_ns.saturating_add(RENEW_EVERY_NS);
        self.broken = false;
        true
    }

    /// Checks the number of failed connections once the port's queue is empty.
    pub(crate) fn look(&mut self, degraded: u64, now_ns: impl FnOnce() -> u64) -> Look {
        if degraded == self.seen {
            if !self.broken {
                self.failing_since_ns = None;
            }
            return Look::Whole;
        }
        self.seen = degraded;
        self.broken = true;
        let now_ns = now_ns();
        if self.outlasted(now_ns) {
            return Look::Failing {
                connections: degraded,
            };
        }
        if now_ns < self.renew_from_ns {
            return Look::Whole;
        }
        Look::Renew
    }

    /// Records that the port could not be recreated. Returns true if the failure has lasted long
    /// enough to be an error.
    pub(crate) fn failed(&mut self, now_ns: u64) -> bool {
        self.broken = true;
        self.renew_from_ns = now_ns.saturating_add(RETRY_EVERY_NS);
        self.outlasted(now_ns)
    }

    fn outlasted(&mut self, now_ns: u64) -> bool {
        let since_ns = *self.failing_since_ns.get_or_insert(now_ns);
        now_ns.saturating_sub(since_ns) >= RENEW_EVERY_NS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn at(now_ns: u64) -> impl FnOnce() -> u64 {
        move || now_ns
    }

    #[test]
    fn a_port_whose_connection_fails_once_is_recreated_at_once_without_an_error() {
        let mut repair = Repair::default();
        assert!(!repair.is_due(at(0)));
        assert_eq!(repair.look(1, at(5 * MS)), Look::Renew);
        assert!(repair.is_due(at(5 * MS)));
        assert_eq!(repair.look(1, at(5 * MS)), Look::Whole);
        assert!(!repair.is_due(at(9_000 * MS)), "it is whole again");
        assert_eq!(repair.look(2, at(9_000 * MS)), Look::Renew, "long after");
    }

    #[test]
    fn a_failure_of_a_second_is_an_error_and_retried_once_a_second() {
        let mut repair = Repair::default();
        assert_eq!(repair.look(1, at(0)), Look::Renew);
        assert!(repair.is_due(at(0)));
        assert_eq!(repair.look(2, at(MS)), Look::Whole, "too soon to try again");
        for now_ms in [2, 500, 999] {
            assert!(!repair.is_due(at(now_ms * MS)), "at {now_ms} ms");
            assert_eq!(repair.look(2, at(now_ms * MS)), Look::Whole);
        }
        for second in 1..4 {
            let now_ns = second * 1_000 * MS;
            assert!(repair.is_due(at(now_ns)));
            let connections = 2 + second;
            assert_eq!(
                repair.look(connections, at(now_ns)),
                Look::Failing { connections }
            );
        }
        assert!(repair.is_due(at(4_000 * MS)));
        assert_eq!(repair.look(5, at(4_000 * MS)), Look::Whole, "healed");
        assert_eq!(repair.look(6, at(6_000 * MS)), Look::Renew, "a new failure");
    }

    #[test]
    fn a_port_that_cannot_be_created_is_retried_soon_and_is_an_error_after_a_second() {
        let mut repair = Repair::default();
        assert_eq!(repair.look(1, at(0)), Look::Renew);
        assert!(repair.is_due(at(0)));
        assert!(!repair.failed(0));
        assert!(!repair.is_due(at(19 * MS)));
        assert!(repair.is_due(at(20 * MS)));
        assert!(!repair.failed(20 * MS));
        assert!(repair.is_due(at(1_000 * MS)));
        assert!(repair.failed(1_000 * MS));
    }
}
