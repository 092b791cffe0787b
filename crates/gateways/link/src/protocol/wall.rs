//! Clock offsets from realtime clocks that are kept together, for instance by PTP.
//!
//! Realtime minus monotonic changes only when the realtime clock is set, because Linux slews both
//! alike. Each host sends its own difference. If two realtime clocks differ by at most `within`,
//! the offset between the monotonic clocks is the difference of the two numbers ± `within`,
//! whatever the delay of the message.

/// Minimum time since the realtime clock was set before it is used. It equals the longest delay of
/// a message that counts, so that the receiver's number has not changed since the message was sent.
pub(crate) const STEADY_NS: u64 = 10_000_000_000;
/// Maximum error of the reported clock offset.
pub(crate) const READ_NS: u64 = 1_000;

/// Tolerance between readings: processor counters and the kernel's rounding.
const INEXACT_NS: u64 = 100;

/// This host's realtime clock, with the bound between the clocks of two hosts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RealtimeClock {
    /// Realtime minus monotonic, ns, never 0.
    pub(crate) realtime_ns: u64,
    pub(crate) within_ns: u64,
}

/// Both clocks of a host, read together.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reading {
    /// Monotonic clock, ns.
    pub(crate) now_ns: u64,
    /// Bounds of realtime minus monotonic, ns.
    pub(crate) between_ns: (u64, u64),
    /// The kernel reports the realtime clock as synchronised.
    pub(crate) is_synchronised: bool,
}

/// Realtime minus monotonic on this host, since the realtime clock was last set.
#[derive(Debug, Default)]
pub(crate) struct Wall {
    /// Intersection of the bounds of all readings since then.
    between_ns: Option<(u64, u64)>,
    since_ns: u64,
}

impl Wall {
    /// Adds a reading. Returns the difference if the clock is synchronised and was not set for a
    /// while.
    pub(crate) fn note(&mut self, reading: Reading) -> Option<u64> {
        let (lo_ns, hi_ns) = reading.between_ns;
        let (lo_ns, hi_ns) = (lo_ns.saturating_sub(INEXACT_NS), hi_ns.saturating_add(INEXACT_NS));
        let known = self.between_ns.map(|(lo, hi)| (lo.max(lo_ns), hi.min(hi_ns)));
        let (lo_ns, hi_ns) = match known {
            Some(known) if known.0 <= known.1 => known,
            _ => {
                self.since_ns = reading.now_ns;
                (lo_ns, hi_ns)
            }
        };
        self.between_ns = Some((lo_ns, hi_ns));
        let is_steady = reading.now_ns.saturating_sub(self.since_ns) >= STEADY_NS;
        let width_ns = hi_ns.checked_sub(lo_ns)?;
        let is_known = reading.is_synchronised && is_steady && width_ns <= 2 * READ_NS;
        (is_known && lo_ns > 0).then_some(lo_ns + width_ns / 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const R: u64 = 1_700_000_000 * SECOND;

    fn read(at_s: u64, between_ns: (u64, u64), is_synchronised: bool) -> Reading {
        Reading { now_ns: at_s * SECOND, between_ns, is_synchronised }
    }

    #[test]
    fn a_clock_is_used_once_it_was_not_set_for_as_long_as_a_message_may_take() {
        let mut wall = Wall::default();
        for at_s in 5..15 {
            assert_eq!(wall.note(read(at_s, (R, R + 80), true)), None, "{at_s}");
        }
        assert_eq!(wall.note(read(15, (R, R + 80), true)), Some(R + 40));
        // Each reading narrows the bounds. One that was interrupted does not widen them.
        assert_eq!(wall.note(read(16, (R + 60, R + 140), true)), Some(R + 70));
        assert_eq!(wall.note(read(17, (R - SECOND, R + 75), true)), Some(R + 67));
        assert_eq!(wall.note(read(18, (R, R + 80), false)), None, "not kept");
        assert_eq!(wall.note(read(19, (R, R + 80), true)), Some(R + 67));
        for step_ns in [1_000, SECOND] {
            let stepped = (R + step_ns, R + step_ns + 80);
            let mut wall = Wall::default();
            assert_eq!(wall.note(read(1, (R, R + 80), true)), None);
            assert!(wall.note(read(20, (R, R + 80), true)).is_some());
            assert_eq!(wall.note(read(21, stepped, true)), None, "set");
            assert_eq!(wall.note(read(30, stepped, true)), None);
            assert!(wall.note(read(31, stepped, true)).is_some());
        }
    }

    #[test]
    fn readings_that_show_too_little_or_nothing_are_not_used() {
        for between_ns in [(R, R + 2 * READ_NS + 1), (0, 0), (R + SECOND, R), (0, u64::MAX)] {
            let mut wall = Wall::default();
            assert_eq!(wall.note(read(1, between_ns, true)), None);
            assert_eq!(wall.note(read(20, between_ns, true)), None, "{between_ns:?}");
        }
    }
}
