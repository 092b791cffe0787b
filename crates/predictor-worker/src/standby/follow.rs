//! What a worker that stands by knows of its robots: the newest state of the worker that serves, and the samples that came
//! since.
//!
//! Frames are kept for some seconds and forgotten then, because a state that came later contains them. Where no state comes
//! any more, as from a dead host whose lease runs on, or until an operator commands, the fleet is restored from the last one
//! and takes the frames as they become old, as if it served: the memory is bounded, and the wait is not.

use joulebus_bus::clock;
use joulebus_fleet::Fleet;

use super::backlog::{Backlog, Held};
use super::places::Places;
use super::restore::{Restored, newest, restore};

/// How often it is looked which state is the newest.
const LOOK_EVERY_NS: u64 = 1_000_000_000;
/// A state that was taken so long after a frame came here contains it, or never will.
const CONTAINED_NS: u64 = 5_000_000_000;

/// The frames that were taken without output.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Replayed {
    pub(crate) frames: u64,
    pub(crate) samples: u64,
}

/// The newest state in the files: its term, and when it was taken.
type Order = (u64, u64);

/// Follows a worker elsewhere.
#[derive(Debug)]
pub(crate) struct Following {
    backlog: Backlog,
    period_ns: u64,
    newest: Option<Order>,
    look_ns: u64,
    /// Which state the fleet was restored from.
    base: Option<Order>,
    restored: Option<Restored>,
    replayed: Replayed,
    tick_ns: Option<u64>,
}

impl Following {
    pub(crate) fn new(capacity: usize, period_ns: u64) -> Self {
        Self {
            backlog: Backlog::new(capacity),
            period_ns,
            newest: None,
            look_ns: 0,
            base: None,
            restored: None,
            replayed: Replayed::default(),
            tick_ns: None,
        }
    }

    /// Keeps a frame; false if there is room for no more until [`Following::advance`].
    pub(crate) fn keep(&mut self, held: Held) -> bool {
        self.backlog.keep(held);
        !self.backlog.is_full()
    }

    /// Forgets frames that have become old, or has the fleet take them if no state contains them.
    pub(crate) fn advance(&mut self, fleet: &mut Fleet, places: &Places) {
        let now_ns = clock::monotonic_ns();
        if now_ns >= self.look_ns {
            self.look_ns = now_ns.saturating_add(LOOK_EVERY_NS);
            self.newest = newest(places);
        }
        while let Some(held) = self.backlog.pop_due(now_ns) {
            if self
                .newest
                .is_some_and(|(_, taken_ns)| !is_contained(&held, taken_ns))
            {
                self.begin(fleet, places);
                self.take(fleet, &held);
            }
        }
    }

    /// Has the fleet take all that is here, as if it had been there, without output.
    pub(crate) fn take_over(
        mut self,
        fleet: &mut Fleet,
        places: &Places,
    ) -> (Option<Restored>, Replayed) {
        self.newest = newest(places);
        self.begin(fleet, places);
        while let Some(held) = self.backlog.pop() {
            self.take(fleet, &held);
        }
        (self.restored, self.replayed)
    }

    /// Restores the newest state, unless that is where the fleet is from.
    fn begin(&mut self, fleet: &mut Fleet, places: &Places) {
        if self.base.is_none() || self.base != self.newest {
            self.base = self.newest;
            self.restored = restore(fleet, places);
            (self.replayed, self.tick_ns) = (Replayed::default(), None);
        }
    }

    fn take(&mut self, fleet: &mut Fleet, held: &Held) {
        if fleet.has_accounted(&held.header, held.taken_ns) {
            return;
        }
        let after_ns = held.taken_ns.saturating_add(self.period_ns);
        let next_ns = *self.tick_ns.get_or_insert(after_ns);
        if held.taken_ns >= next_ns {
            fleet.tick(held.taken_ns, false);
            self.tick_ns = Some(after_ns);
        }
        fleet.take(&held.header, &held.samples, held.taken_ns);
        self.replayed.frames += 1;
        self.replayed.samples += held.samples.len() as u64;
    }
}

/// Whether a state that was taken at `taken_ns` contains a frame, or no later one of that worker will.
const fn is_contained(held: &Held, taken_ns: u64) -> bool {
    held.taken_ns.saturating_add(CONTAINED_NS) <= taken_ns
}
