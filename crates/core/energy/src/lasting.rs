//! The power of a robot for as long as its battery lasts.

// Indexed by shadow, so that the loop over robots becomes vectors.
#![allow(clippy::needless_range_loop)]

use crate::calibration::PlatformErrors;
use crate::levels::SHADOWS;
use crate::model::EnergyModel;
use crate::quantiles;
use crate::state::error_shares;

/// Seconds of readings that weigh as much as the platform's mean: over hours a robot's next
/// missions are as likely another's as its last.
const PRIOR_S: f32 = 600.0;
/// Deviations of the errors by which a robot's mean may differ from the platform's, until the
/// platform's weighs less.
const USUAL: f32 = 2.0;
/// Seconds of readings after which half of such a difference counts.
const START_S: f32 = 300.0;
/// Width of the interval over a long time, in the width of the longest calibrated horizon.
const WIDTH: f32 = 0.8;
/// Time over which missions vary, s: over twice this, half of the variance is the missions'.
const MISSION_S: f32 = 600.0;

/// The power of a platform's robots over hours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lasting {
    /// Weight of each watched horizon's bounds at the longest calibrated horizon.
    shares: [f32; SHADOWS],
    mean_w: f32,
    mean_share: f32,
    /// Deviation of the errors at the longest calibrated horizon, relative.
    spread: f32,
    /// Middle and half width of the longest calibrated interval, relative.
    trained: (f32, f32),
}

/// Mean power of a robot until its battery is empty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastingPower {
    /// Expected, W.
    pub mean_w: f32,
    /// Distance of the lower bound over a very long time from it, W, 0 or less.
    pub below_w: f32,
    /// Distance of the upper bound, W, 0 or more.
    pub above_w: f32,
}

impl EnergyModel {
    /// The power over hours. `None` for a model without calibrated errors.
    pub fn lasting(&self) -> Option<Lasting> {
        let longest_s = self.longest_s();
        (longest_s > 0.0).then(|| Lasting {
            shares: error_shares(longest_s),
            mean_w: self.command.mean_w,
            mean_share: self.mean_share,
            spread: self.spread_at(longest_s),
            trained: quantiles::middle_and_half(&self.errors_at(longest_s)),
        })
    }
}

impl Lasting {
    /// The power of a robot: of the energy and the time of its longest level, J and s, and what its
    /// platform has shown.
    ///
    /// The mean of the platform's robots is the prior of the robot's own over its longest level. The
    /// bounds are those of the longest calibrated horizon, as the robots of the platform have since
    /// widened them. They are not narrowed: those errors are of known commands.
    #[inline(always)]
    pub fn of(&self, (energy_j, time_s): (f32, f32), platform: &PlatformErrors) -> LastingPower {
        let (fleet_w, bounds) = (self.mean_w * platform.memory.power, &platform.plans);
        let read = time_s > 0.0;
        let (energy_j, time_s) =
            (if read { energy_j } else { 0.0 }, if read { time_s } else { 0.0 });
        let apart_w = (energy_j - fleet_w * time_s).abs() / time_s.max(f32::MIN_POSITIVE);
        let beyond = (apart_w / (self.spread * fleet_w) - USUAL).max(0.0);
        let prior_s = PRIOR_S / (1.0 + beyond * beyond * time_s / (time_s + START_S));
        let mean_w = ((energy_j + prior_s * fleet_w) / (time_s + prior_s)).max(0.0);
        let scale_w = mean_w + self.mean_share * (fleet_w - mean_w);
        // Sums over all watched horizons: an index that is not constant would keep the loop over
        // robots from becoming vectors.
        let (mut middle, mut half) = (0.0, 0.0);
        for shadow in 0..SHADOWS {
            let (middle_there, half_there) = bounds.middle_and_half(shadow);
            middle += self.shares[shadow] * middle_there;
            half += self.shares[shadow] * half_there;
        }
        let (lower, upper) = ((middle - half).min(-1.0), (middle + half).max(1.0));
        let (trained_middle, trained_half) = self.trained;
        LastingPower {
            mean_w,
            below_w: (scale_w * (trained_middle + trained_half * lower)).min(0.0),
            above_w: (scale_w * (trained_middle + trained_half * upper)).max(0.0),
        }
    }
}

impl LastingPower {
    /// Bounds of the 90 % interval of the mean power over a duration, W, the lower one 0 or more.
    /// The shorter it is, the fewer missions it averages over.
    #[inline(always)]
    pub fn range_w(&self, duration_s: f32) -> [f32; 2] {
        let missions = 1.0 + MISSION_S / duration_s.max(1.0);
        let width = WIDTH * missions.sqrt();
        [(self.mean_w + width * self.below_w).max(0.0), self.mean_w + width * self.above_w]
    }
}
