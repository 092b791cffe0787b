//! Names a tick.

/// A tick of a run of the worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct TickId {
    /// The run: its epoch.
    pub(super) run: u64,
    pub(super) tick: u64,
}

impl TickId {
    pub(super) const fn new(run: u64, tick: u64) -> Self {
        Self { run, tick }
    }

    /// True if `next` is the tick after this one. Numbers in a capture may be any.
    pub(super) fn is_followed_by(self, next: Self) -> bool {
        self.tick.checked_add(1).is_some_and(|tick| Self { tick, ..self } == next)
    }
}
