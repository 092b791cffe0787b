//! Relation of the times in a capture to the clocks of the host.

/// Converts monotonic to Unix time by a fixed offset, so that both have the same order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Offset from monotonic to Unix ns.
    pub offset_ns: i64,
}

impl Clock {
    /// The offset between two clocks that were read at the same time.
    #[must_use]
    pub const fn between(unix_ns: u64, monotonic_ns: u64) -> Self {
        // Both are below 2^63 ns for the next 200 years.
        Self { offset_ns: unix_ns.wrapping_sub(monotonic_ns) as i64 }
    }

    /// Monotonic ns to Unix ns.
    #[must_use]
    pub const fn unix_ns(self, monotonic_ns: u64) -> u64 {
        monotonic_ns.saturating_add_signed(self.offset_ns)
    }

    /// Unix ns, as in a capture, to monotonic ns.
    #[must_use]
    pub const fn monotonic_ns(self, unix_ns: u64) -> u64 {
        unix_ns.saturating_add_signed(self.offset_ns.saturating_neg())
    }
}
