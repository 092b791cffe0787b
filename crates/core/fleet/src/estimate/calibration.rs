//! The errors of all robots of a platform.

use std::sync::atomic::{AtomicI64, Ordering};

use joulebus_energy::{
    CLASSES, Calibration, ERRORS, EnergyModel, ErrorCounts, GROUPS, NewErrors, PARTS,
    PlatformErrors, SHADOWS, Shown, group_of,
};
use serde::{Deserialize, Deserializer, Serialize};

use crate::layout::versions::{NARROW, READ, is_before};

/// The errors of all robots of a platform. Shards count them in any order while they share this.
/// The fleet adds the counts before the next tick.
#[derive(Debug)]
pub(crate) struct SharedErrors {
    calibration: Calibration,
    counts: ErrorCounts<AtomicI64>,
}

/// The same as a value.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct SavedErrors {
    #[serde(deserialize_with = "read_errors")]
    seen: ErrorCounts<f32>,
    #[serde(deserialize_with = "read_errors")]
    counts: ErrorCounts,
}

/// Reads the errors of a platform. Versions before 0x12 lack the levels that its robots have shown,
/// and versions before 0x13 have the scatter of the levels before them.
fn read_errors<'de, T, D>(from: D) -> Result<ErrorCounts<T>, D::Error>
where
    T: Deserialize<'de> + Default + Copy,
    D: Deserializer<'de>,
{
    #[derive(Deserialize)]
    struct Before<T, G> {
        classes: [[T; CLASSES]; ERRORS],
        pulls: [[T; PARTS]; SHADOWS],
        groups: [G; GROUPS],
    }
    if !is_before(NARROW) {
        return ErrorCounts::deserialize(from);
    }
    if !is_before(READ) {
        let Before { classes, pulls, groups } = Before::<T, [[T; 2]; 5]>::deserialize(from)?;
        let groups = groups.map(|[power, start, trust, _, level]| [power, start, trust, level]);
        return Ok(ErrorCounts { classes, pulls, groups });
    }
    let Before { classes, pulls, groups } = Before::<T, [[T; 2]; 4]>::deserialize(from)?;
    let groups = groups.map(|[power, start, trust, _]| [power, start, trust, [T::default(); 2]]);
    Ok(ErrorCounts { classes, pulls, groups })
}

impl SavedErrors {
    /// True if errors could have led to it.
    pub(crate) fn is_sound(&self) -> bool {
        /// More than all robots of all ticks can have shown.
        const MOST: i64 = 1 << 50;
        let is_number = |number: i64| number.unsigned_abs() < MOST as u64;
        let is_amount = |number: i64| (0..MOST).contains(&number);
        let mut counted = self.counts.classes.as_flattened().iter();
        let mut pulled = self.counts.pulls.iter();
        let mut shown = self.counts.groups.as_flattened().iter();
        are_sound(&self.seen)
            && counted.all(|count| (0..1_000_000_000).contains(count))
            && pulled.all(|[last, own, square]| {
                is_number(*last) && is_number(*own) && is_amount(*square)
            })
            && shown.all(|[weight, sum]| is_amount(*weight) && is_number(*sum))
    }
}

/// True if errors could have led to these remembered ones.
fn are_sound(seen: &ErrorCounts<f32>) -> bool {
    const MAX: f32 = 1e9;
    let mut classes = seen.classes.as_flattened().iter();
    let is_sound = |[last, own, square]: &[f32; PARTS]| {
        last.abs() < MAX && own.abs() < MAX && (0.0..MAX).contains(square)
    };
    classes.all(|count| (0.0..MAX).contains(count))
        && seen.pulls.iter().all(is_sound)
        && seen.has_sound_groups()
}

impl SharedErrors {
    pub(crate) fn new(model: &EnergyModel) -> Self {
        Self { calibration: Calibration::new(model), counts: ErrorCounts::default() }
    }

    /// The errors that forecasts of this tick use.
    #[inline(always)]
    pub(crate) fn platform(&self) -> &PlatformErrors {
        self.calibration.platform()
    }

    /// Counts the errors of a robot, and what it and its [`Level`](crate::alarms::level::Level)
    /// have shown with them unless it is on its charger.
    pub(crate) fn count(
        &self,
        (robot, level): (u32, Option<f32>),
        errors: &NewErrors,
        charging: bool,
    ) {
        if !charging {
            self.show(robot, &errors.shown_with(level));
        }
        for (counts, class) in self.counts.classes.iter().zip(errors.classes) {
            if let Some(count) = class.and_then(|class| counts.get(usize::from(class))) {
                count.fetch_add(1, Ordering::Relaxed);
            }
        }
        let pulls = self.counts.pulls.as_flattened().iter();
        for (sum, pull) in pulls.zip(errors.pulls.as_flattened()).filter(|(_, pull)| **pull != 0) {
            sum.fetch_add(*pull, Ordering::Relaxed);
        }
    }

    /// Adds what a robot has shown.
    pub(crate) fn show(&self, robot: u32, shown: &Shown) {
        let sums = self.counts.groups[group_of(robot)].as_flattened().iter();
        for (sum, number) in sums.zip(shown.as_flattened()).filter(|(_, number)| **number != 0) {
            sum.fetch_add(*number, Ordering::Relaxed);
        }
    }

    /// Adds what was counted since the last tick began.
    pub(crate) fn add_counted(&mut self) {
        let counts = std::mem::take(&mut self.counts);
        self.calibration.add(&counts.map(|count| count.load(Ordering::Relaxed)));
    }

    /// The errors that are remembered.
    pub(crate) const fn seen(&self) -> &ErrorCounts<f32> {
        self.calibration.seen()
    }

    /// Continues from remembered errors of an earlier run, without the levels: files of older
    /// versions have another quantity in their place. Returns whether errors could have led to them.
    pub(crate) fn remember(&mut self, seen: &ErrorCounts<f32>) -> bool {
        let seen = seen.without_levels();
        let is_sound = are_sound(&seen);
        if is_sound {
            self.calibration.restore(&seen);
        }
        is_sound
    }

    pub(crate) fn saved(&self) -> SavedErrors {
        SavedErrors {
            seen: *self.seen(),
            counts: self.counts.map(|count| count.load(Ordering::Relaxed)),
        }
    }

    pub(crate) fn restore(&mut self, saved: &SavedErrors) {
        self.calibration.restore(&saved.seen);
        self.counts = saved.counts.map(|count| AtomicI64::new(*count));
    }
}
