//! Converts instants of one monotonic clock to those of another.

/// An offset between two monotonic clocks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shift {
    pub(crate) offset_ns: i64,
}

impl Shift {
    /// Moves an instant. 0 means none, and stays. Returns by how much it would be before the start
    /// of the clock, ns.
    pub(crate) fn instant(self, stamp_ns: &mut u64) -> u64 {
        if *stamp_ns == 0 {
            return 0;
        }
        let offset_ns = self.offset_ns.unsigned_abs();
        if self.offset_ns >= 0 {
            *stamp_ns = stamp_ns.saturating_add(offset_ns);
            return 0;
        }
        let before_ns = offset_ns.saturating_sub(*stamp_ns - 1);
        *stamp_ns = stamp_ns.saturating_sub(offset_ns).max(1);
        // The distance to 1, the first instant.
        before_ns.min(offset_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instant_moves_exactly_none_stays_none_and_what_lies_before_the_clock_is_reported() {
        for (stamp_ns, offset_ns, moved_ns, before_ns) in [
            (0, 5, 0, 0),
            (0, -5, 0, 0),
            (7, 5, 12, 0),
            (7, -5, 2, 0),
            (7, -6, 1, 0),
            (7, -7, 1, 1),
            (7, -10, 1, 4),
            (7, i64::MIN, 1, (1 << 63) - 6),
            (u64::MAX - 1, 5, u64::MAX, 0),
            (u64::MAX, i64::MIN, (1 << 63) - 1, 0),
        ] {
            let mut stamp = stamp_ns;
            let before = Shift { offset_ns }.instant(&mut stamp);
            assert_eq!((stamp, before), (moved_ns, before_ns), "{stamp_ns} {offset_ns}");
        }
    }
}
