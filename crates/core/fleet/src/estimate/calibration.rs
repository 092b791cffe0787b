//! The errors of all robots of a platform.

use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_energy::{CLASSES, Calibration, EnergyModel, ErrorBounds, ErrorCounts, SHADOWS};
use serde::{Deserialize, Serialize};

/// The errors of all robots of a platform. Shards count them in any order while they share this;
/// the fleet adds the counts before the next tick.
#[derive(Debug)]
pub(crate) struct SharedErrors {
    calibration: Calibration,
    counts: ErrorCounts<AtomicU32>,
}

/// The same as a value.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct SavedErrors {
    pub seen: ErrorCounts<f32>,
    counts: ErrorCounts,
}

impl SharedErrors {
    pub(crate) fn new(model: &EnergyModel) -> Self {
        Self { calibration: Calibration::new(model), counts: Default::default() }
    }

    /// The bounds of new robots' intervals in this tick.
    #[inline(always)]
    pub(crate) fn bounds(&self) -> &ErrorBounds {
        self.calibration.bounds()
    }

    /// Counts the errors of a robot.
    pub(crate) fn count(&self, classes: [Option<u8>; SHADOWS]) {
        for (counts, class) in self.counts.iter().zip(classes) {
            if let Some(class) = class {
                counts[usize::from(class) % CLASSES].fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Adds what was counted since the last tick began.
    pub(crate) fn add_counted(&mut self) {
        let counts = std::mem::take(&mut self.counts);
        self.calibration.add(&counts.map(|counts| counts.map(AtomicU32::into_inner)));
    }

    pub(crate) fn saved(&self) -> SavedErrors {
        let count = |count: &AtomicU32| count.load(Ordering::Relaxed);
        SavedErrors {
            seen: *self.calibration.seen(),
            counts: self.counts.each_ref().map(|counts| counts.each_ref().map(count)),
        }
    }

    pub(crate) fn restore(&mut self, saved: &SavedErrors) {
        self.calibration.restore(&saved.seen);
        self.counts = saved.counts.map(|counts| counts.map(AtomicU32::new));
    }
}
