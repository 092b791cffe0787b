//! The decrease of alarms with the limit, beyond the recordings.

use joulebus_statistics::poisson::upper_decay;

use super::grid::{Curves, STEPS};

/// Number of recordings that a tail is fitted to, if there are as many.
const FITTED: usize = 20;

/// A power law of the limit: every step of the grid, which is a factor, divides the alarms by the
/// same number. For a sum of independent residuals alarms decrease faster, exponentially.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tail {
    /// The step that it begins at.
    pub from: usize,
    /// Recordings that reached it.
    pub recordings: u64,
    /// Upper bound of the alarms there, a robot and hour.
    rate: f64,
    /// Upper bound of the share that remains after a step.
    decay: f64,
}

impl Tail {
    /// The tail of the highest steps that enough recordings reached. `None` if none reached any.
    pub(super) fn new(curves: &Curves, kind: usize, confidence: f64) -> Option<Self> {
        let mut peaks: Vec<usize> = curves.0.iter().filter_map(|curve| curve.peak(kind)).collect();
        peaks.sort_unstable_by(|one, other| other.cmp(one));
        let from = *peaks.get(FITTED - 1).or(peaks.last())?;
        let beyond = || peaks.iter().filter(|peak| **peak >= from);
        let steps: usize = beyond().map(|peak| peak - from).sum();
        let recordings = beyond().count() as u64;
        // Each of the two bounds may fail in half of the cases.
        let each = 0.5 * (1.0 + confidence);
        Some(Self {
            from,
            recordings,
            rate: curves.at_most(&[(kind, from)], each),
            decay: upper_decay(steps as u64, recordings, each),
        })
    }

    /// Alarms at a step from the first on, a robot and hour.
    pub(super) fn rate(&self, step: usize) -> f64 {
        self.rate * libm::pow(self.decay, step.saturating_sub(self.from) as f64)
    }

    /// The lowest step at which alarms are as rare as allowed. [`STEPS`] if there is none.
    pub(super) fn step_for(&self, allowed: f64) -> usize {
        let rare = (self.from..STEPS).find(|step| self.rate(*step) <= allowed);
        rare.unwrap_or(STEPS)
    }
}
