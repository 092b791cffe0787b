//! The energy of a robot that goes on as it does.

// Several arrays are indexed alike, and the lanes of a block are computed side by side.
#![allow(clippy::needless_range_loop)]

use crate::calibration::{PARTS, PlatformErrors};
use crate::levels::{LEVELS, NEWEST, SHADOWS};
use crate::model::{EnergyModel, extrapolated};
use crate::quantiles;
use crate::state::{
    EnergyState, START_S, contradictions, error_shares, mixed, outlook_parts, weighted,
};

/// Energy of a robot over several horizons, if it goes on as it does: its future commands are
/// unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyOutlook<const HORIZONS: usize> {
    /// Expected energy, J.
    pub energy_j: [f32; HORIZONS],
    /// Lower end of its 90 % interval, J. NaN if errors are unknown.
    pub lo_j: [f32; HORIZONS],
    /// Upper end, J. NaN if errors are unknown.
    pub hi_j: [f32; HORIZONS],
}

/// The part of a platform's model that outlooks of its robots need.
#[derive(Clone, Debug, PartialEq)]
pub struct OutlookModel<const HORIZONS: usize> {
    horizons: [Horizon; HORIZONS],
    is_bounded: bool,
    prior_s: [f32; LEVELS],
    mean_w: f32,
    mean_share: f32,
    /// Deviations of the errors, with which levels are compared.
    newest_spreads: [f32; NEWEST],
}

/// The model at one horizon.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Horizon {
    seconds: f32,
    weights: [f32; LEVELS],
    /// 1 through the square of the errors' deviation.
    per_variance: f32,
    /// Weights of the bounds of a robot's errors.
    shares: [f32; SHADOWS],
    /// Middle and half width of the trained 90 % interval, relative, at the longest horizon whose
    /// errors are known, if this one is longer. NaN if unknown.
    middle: f32,
    half: f32,
    /// Share of this horizon beyond that.
    beyond: f32,
}

impl EnergyModel {
    /// Prepares outlooks over horizons, s, above 0, ascending.
    pub fn outlook<const HORIZONS: usize>(
        &self,
        horizons_s: [f32; HORIZONS],
    ) -> OutlookModel<HORIZONS> {
        let horizon = |seconds: f32| {
            let spread = self.spread_at(seconds);
            let known = |value| if self.longest_s() > 0.0 { value } else { f32::NAN };
            let (middle, half) = quantiles::middle_and_half(&self.known_errors(seconds));
            Horizon {
                seconds,
                weights: self.weights_at(seconds).0,
                per_variance: 1.0 / (spread * spread),
                shares: error_shares(seconds),
                middle: known(middle),
                half: known(half),
                beyond: self.share_beyond(seconds),
            }
        };
        OutlookModel {
            horizons: horizons_s.map(horizon),
            is_bounded: self.longest_s() > 0.0,
            prior_s: self.prior_s,
            mean_w: self.command.mean_w,
            mean_share: self.mean_share,
            newest_spreads: self.newest_spreads(),
        }
    }
}

impl<const HORIZONS: usize> OutlookModel<HORIZONS> {
    /// Number of horizons, from the shortest, with bounds: all, or none of a model without errors.
    pub const fn bounded(&self) -> usize {
        if self.is_bounded { HORIZONS } else { 0 }
    }

    /// True if the bounds of the longest horizon are extrapolated beyond those whose errors are known.
    pub const fn is_extrapolated(&self) -> bool {
        self.horizons[HORIZONS - 1].beyond > 0.0
    }

    /// The energy of a robot. A part of it is the mean power of its levels, weighted for each
    /// horizon, with the platform's mean as the prior: up to rounding the part of
    /// [`EnergyModel::forecast`] that no command explains. The other parts are the last reading,
    /// NaN if unknown, and the mean of all that the robot drew. Their shares and the bounds are
    /// those that the platform's errors of outlooks lead to.
    ///
    /// Without branches, in several short loops: the compiler unrolls a loop only up to a size, and
    /// a loop that remains keeps the loop over robots around it from becoming vectors.
    #[inline(always)]
    pub fn of(
        &self,
        state: &EnergyState,
        platform: &PlatformErrors,
        last_w: f32,
    ) -> EnergyOutlook<HORIZONS> {
        let mut mean_w = [0.0; HORIZONS];
        let contradictions = contradictions(&state.metered, self.mean_w, &self.newest_spreads);
        // A loop, because calls of `map` are not always inlined.
        let mut weights = [([0.0; LEVELS], 0.0); HORIZONS];
        for place in 0..HORIZONS {
            weights[place] = weighted(self.horizons[place].weights, &contradictions);
        }
        let (mut squares, mut above_j, mut are_known) =
            ([0.0; LEVELS], [0.0; LEVELS], [false; LEVELS]);
        for level in 0..LEVELS {
            let (time_s, energy_j) = (state.metered.time_s[level], state.metered.energy_j[level]);
            let command_j = state.metered.command_j[level];
            let known = (time_s > 0.0) & (command_j > 0.0);
            let prior_s = self.prior_s[level];
            // As `shrunk`, with fewer divisions: a level that is far from the platform's is
            // believed sooner.
            let differs = (energy_j - command_j) / command_j;
            let started_s = (time_s + START_S) * (time_s + START_S);
            let is_level = time_s * time_s * time_s / (started_s * (time_s + prior_s));
            squares[level] = differs * differs * is_level;
            above_j[level] = energy_j - self.mean_w * time_s;
            are_known[level] = known;
        }
        for place in 0..HORIZONS {
            for level in 0..LEVELS {
                let time_s = state.metered.time_s[level];
                let sooner = 1.0 + squares[level] * self.horizons[place].per_variance;
                let above_w = sooner * above_j[level] / (sooner * time_s + self.prior_s[level]);
                let above_w = if are_known[level] { above_w } else { 0.0 };
                mean_w[place] += weights[place].0[level] * (self.mean_w + above_w);
            }
        }
        let mut outlook = EnergyOutlook {
            energy_j: [0.0; HORIZONS],
            lo_j: [0.0; HORIZONS],
            hi_j: [0.0; HORIZONS],
        };
        let bounds = &platform.outlooks;
        let (mut lower, mut upper) = ([0.0; HORIZONS], [0.0; HORIZONS]);
        for place in 0..HORIZONS {
            for shadow in 0..SHADOWS {
                lower[place] += self.horizons[place].shares[shadow] * bounds.lower[shadow];
                upper[place] += self.horizons[place].shares[shadow] * bounds.upper[shadow];
            }
        }
        let mut parts = [[0.0; PARTS]; HORIZONS];
        for place in 0..HORIZONS {
            for shadow in 0..SHADOWS {
                for part in 0..PARTS {
                    parts[place][part] +=
                        self.horizons[place].shares[shadow] * platform.shares[shadow][part];
                }
            }
        }
        for (place, horizon) in self.horizons.iter().enumerate() {
            let (lower, upper, parts) = (lower[place], upper[place], parts[place]);
            let parts_w = outlook_parts(&state.metered, &contradictions, mean_w[place], last_w);
            let energy_j = mixed(&parts, &parts_w) * horizon.seconds;
            let mean_j = self.mean_w * horizon.seconds;
            // A level that was contradicted widens the interval at once.
            let wider = 0.5 * weights[place].1 * (upper - lower);
            let (lower, upper) = (lower - wider, upper + wider);
            let scale_j = energy_j.abs() + self.mean_share * (mean_j - energy_j.abs());
            let middle = horizon.middle + horizon.half * 0.5 * (lower + upper);
            let half = extrapolated(horizon.half * 0.5 * (upper - lower), horizon.beyond);
            outlook.energy_j[place] = energy_j;
            outlook.lo_j[place] = energy_j + scale_j * (middle - half);
            outlook.hi_j[place] = energy_j + scale_j * (middle + half);
        }
        outlook
    }
}
