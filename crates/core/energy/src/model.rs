//! The energy model of a platform.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::command::{COMBINED_TERMS, CommandModel};
use crate::levels::{LEVELS, NEWEST};
use crate::quantiles::{self, KNOTS};
use crate::ridge::Ridge;

/// Number of horizons at which weights and errors are known.
const HORIZONS: usize = 6;

/// Horizons at which weights and errors are known, s, ascending.
pub const HORIZONS_S: [f32; HORIZONS] = [1.0, 3.0, 10.0, 30.0, 100.0, 300.0];

/// Half width of the 90 % interval of the mean power between drives, relative, that is assumed at
/// least.
const BETWEEN_DRIVES: f32 = 0.08;
/// Half width, relative, below which quantiles have no shape.
const LEAST_HALF: f32 = 1e-4;
/// Quantiles ([`crate::QUANTILES`]) of a normal distribution whose 90 % interval reaches from −1 to 1.
const NORMAL: [f32; KNOTS] = [-1.4143, -1.0, -0.7791, -0.4101, 0.0, 0.4101, 0.7791, 1.0, 1.4143];

/// The energy model of a platform: fitted by training, stored in the model file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnergyModel {
    /// Power of a command.
    pub command: CommandModel,
    /// Seconds of readings that weigh as much as the platform's own level, for each level, 0 or
    /// more.
    pub prior_s: [f32; LEVELS],
    /// Share by which a level that differs from the platform's is a constant additional power at
    /// each horizon, 0 to 1. The rest is a factor of the command's power.
    pub added_shares: [f32; HORIZONS],
    /// Weights of the levels ([`crate::LEVELS_S`]) at each horizon, not negative, 1 in all.
    pub weights: [[f32; LEVELS]; HORIZONS],
    /// Number of horizons, from the shortest, whose errors are known. 0 for a model without.
    pub calibrated: usize,
    /// Quantiles ([`crate::QUANTILES`]) of the error at each horizon: measured minus forecast
    /// energy, relative to the scale of the forecast. Ascending.
    pub errors: [[f32; KNOTS]; HORIZONS],
    /// Share by which the scale of an error is the platform's mean power, 0 to 1. The rest is the
    /// forecast's.
    pub mean_share: f32,
    /// Lowest and highest velocity in the training data, m/s.
    pub v_mps: [f32; 2],
    /// Lowest and highest angular velocity in the training data, rad/s.
    pub omega_radps: [f32; 2],
    /// Maxima of the [combined terms](CommandModel::combined_terms) reached in at least two
    /// recordings of the training data. The first, |vω|, is not compared with plans. `None` in
    /// older files: every step that changes a command then counts as outside the training data.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub combined: Option<[f32; COMBINED_TERMS]>,
    /// Power of commands of which no reading tells the level. `None` in older files, and for models
    /// that do not read commands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ridge: Option<Ridge>,
    /// Lowest and highest mean power over [`RECORDED_S`] in the training data, W: what bounds steps
    /// that no model knows. `None` in older files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded_w: Option<[f32; 2]>,
    /// What the recordings cannot show of plans.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub limits: Vec<Limit>,
    /// Power that the robot draws beside what was recorded, W, at least 0: the hotel load of a
    /// recording of the drives alone. `None` if it is not stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hotel_w: Option<f32>,
}

/// Time over which [`EnergyModel::recorded_w`] are means, s.
pub const RECORDED_S: f32 = 3.0;

/// What the recordings of a model cannot show of plans. An answer to a plan that meets it is weaker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Limit {
    /// The robots never turned. A plan that turns has steps outside the training data.
    NoTurns,
    /// The commands are measured velocities: what a command costs that the robot does not follow is
    /// not known.
    MeasuredVelocities,
    /// No velocities were recorded: commands make no difference.
    NoVelocities,
    /// The recorded power is that of the drives, without the hotel load.
    DrivePower,
}

impl fmt::Display for Limit {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::NoTurns => "no robot turned",
            Self::MeasuredVelocities => "velocities were measured, not commanded",
            Self::NoVelocities => "no velocities were recorded",
            Self::DrivePower => "power of the drives alone",
        })
    }
}

/// Errors of reading an energy model.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum EnergyModelError {
    /// The text cannot be read.
    #[error("the energy model cannot be read: {reason}. Train the model again with this version")]
    Malformed { reason: String },
    /// A value is out of range.
    #[error(
        "the energy model states {what} as {found}, allowed is {allowed}. Train the model again"
    )]
    Value { what: &'static str, found: f32, allowed: &'static str },
}

impl EnergyModel {
    /// The model for a file without an energy model: the mean of the last seconds, independent of
    /// the commands, starting at `mean_w` (W, above 0). Its forecasts have no intervals.
    pub fn untrained(mean_w: f32) -> Self {
        // Neighbouring means. The longer, the longer the horizon.
        let weights = [
            [0.5, 0.5, 0.0, 0.0],
            [0.3, 0.5, 0.2, 0.0],
            [0.0, 0.5, 0.4, 0.1],
            [0.0, 0.2, 0.5, 0.3],
            [0.0, 0.0, 0.5, 0.5],
            [0.0, 0.0, 0.2, 0.8],
        ];
        Self {
            command: CommandModel::constant(mean_w),
            prior_s: [0.03; LEVELS],
            added_shares: [0.0; HORIZONS],
            weights,
            calibrated: 0,
            errors: [[0.0; KNOTS]; HORIZONS],
            mean_share: 0.0,
            v_mps: [f32::MIN, f32::MAX],
            omega_radps: [f32::MIN, f32::MAX],
            combined: Some([f32::MAX; COMBINED_TERMS]),
            ridge: None,
            recorded_w: None,
            limits: Vec::new(),
            hotel_w: None,
        }
    }

    /// Reads the text of [`EnergyModel::to_text`].
    ///
    /// # Errors
    /// [`EnergyModelError`] names the first value that is out of range.
    pub fn from_text(text: &str) -> Result<Self, EnergyModelError> {
        let model: Self = serde_json::from_str(text)
            .map_err(|error| EnergyModelError::Malformed { reason: error.to_string() })?;
        model.check()?;
        Ok(model)
    }

    /// The model as one line of text, for a model file: reading it gives the same bits.
    pub fn to_text(&self) -> String {
        // Plain numbers and names always serialise.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`EnergyModelError::Value`] names the first that is out of range.
    pub fn check(&self) -> Result<(), EnergyModelError> {
        let within = |what, found: f32, lo: f32, hi: f32, allowed| {
            if lo <= found && found <= hi {
                Ok(())
            } else {
                Err(EnergyModelError::Value { what, found, allowed })
            }
        };
        const POSITIVE: &str = "finite and above 0";
        const AT_LEAST_0: &str = "finite and at least 0";
        let share = |what, found| within(what, found, 0.0, 1.0, "0 to 1");
        for weight in self.command.weights {
            within("a weight of the command model", weight, 0.0, f32::MAX, AT_LEAST_0)?;
        }
        let least = f32::MIN_POSITIVE;
        within("the command model's constant", self.command.weights[0], least, f32::MAX, POSITIVE)?;
        within("v₀", self.command.half_v_mps, least, f32::MAX, POSITIVE)?;
        within("ω₀", self.command.half_omega_radps, least, f32::MAX, POSITIVE)?;
        within("the mean power", self.command.mean_w, least, f32::MAX, POSITIVE)?;
        for prior_s in self.prior_s {
            within("a prior's seconds", prior_s, 0.0, f32::MAX, AT_LEAST_0)?;
        }
        for added_share in self.added_shares {
            share("an added share", added_share)?;
        }
        share("the mean's share of the scale", self.mean_share)?;
        for weights in &self.weights {
            for weight in weights {
                share("a level's weight", *weight)?;
            }
            let sum: f32 = weights.iter().sum();
            within("the sum of the levels' weights", sum, 0.999, 1.001, "1")?;
        }
        let horizons = self.calibrated as f32;
        within("the number of horizons", horizons, 0.0, HORIZONS as f32, "0 to 6")?;
        for errors in &self.errors {
            for pair in errors.windows(2) {
                let step = pair[1] - pair[0];
                within("the step to the next quantile", step, 0.0, f32::MAX, AT_LEAST_0)?;
            }
        }
        for highest in self.combined.unwrap_or_default() {
            let what = "a product or change of velocities in the training data";
            within(what, highest, 0.0, f32::MAX, AT_LEAST_0)?;
        }
        if let Some(ridge) = &self.ridge {
            let columns = [&ridge.means, &ridge.weights].into_iter().chain(&ridge.inverse);
            for value in columns.flatten().chain([&ridge.constant_w]) {
                within("a number of the ridge regression", *value, f32::MIN, f32::MAX, "finite")?;
            }
            for value in ridge.scales.iter().chain([&ridge.max_leverage]) {
                within("a scale of the ridge regression", *value, least, f32::MAX, POSITIVE)?;
            }
            let what = "the error of left-out drives";
            within(what, ridge.left_out, 0.0, f32::MAX, AT_LEAST_0)?;
        }
        if let Some([_, highest]) = self.recorded_w {
            within("the highest recorded power", highest, f32::MIN, f32::MAX, "finite")?;
        }
        within("the hotel load", self.hotel_w.unwrap_or(0.0), 0.0, f32::MAX, AT_LEAST_0)?;
        for [lowest, highest] in [self.v_mps, self.omega_radps].into_iter().chain(self.recorded_w) {
            let ordered = if lowest <= highest { 1.0 } else { 0.0 };
            within("the order of a range", ordered, 1.0, 1.0, "ascending")?;
        }
        Ok(())
    }

    /// The longest horizon with an interval, s. 0 without any.
    pub fn longest_s(&self) -> f32 {
        match self.calibrated.min(HORIZONS) {
            0 => 0.0,
            count => HORIZONS_S[count - 1],
        }
    }

    /// True if the errors of a plan of this duration are known. A plan may be a hundredth longer
    /// than
    /// [`EnergyModel::longest_s`]: its steps seldom add up to exactly that.
    pub fn covers(&self, duration_s: f32) -> bool {
        duration_s <= 1.01 * self.longest_s()
    }

    /// The scale of relative errors, J.
    #[inline(always)]
    pub(crate) fn scale_j(&self, energy_j: f32, duration_s: f32) -> f32 {
        let mean_j = self.command.mean_w * duration_s;
        energy_j.abs() + self.mean_share * (mean_j - energy_j.abs())
    }

    /// Weights and added share at a horizon, linear between the known ones.
    #[inline(always)]
    pub(crate) fn weights_at(&self, horizon_s: f32) -> ([f32; LEVELS], f32) {
        let [added_share] = between(&self.added_shares.map(|share| [share]), horizon_s);
        (between(&self.weights, horizon_s), added_share)
    }

    /// Standard deviation of the relative error at a horizon, above 0, of the normal distribution
    /// with the same 90 % interval.
    pub fn spread_at(&self, horizon_s: f32) -> f32 {
        const MIN: f32 = 1e-3;
        let errors = self.errors_at(horizon_s);
        ((errors[7] - errors[1]) / 3.29).max(MIN)
    }

    /// Same as [`EnergyModel::spread_at`], for the horizons of the shortest levels.
    pub(crate) fn newest_spreads(&self) -> [f32; NEWEST] {
        std::array::from_fn(|level| self.spread_at(HORIZONS_S[level]))
    }

    /// Quantiles of the error over a duration, moved and stretched so that the 90 % interval has this
    /// middle and half width, in units of the trained one.
    ///
    /// Beyond the longest known horizon they are wider. The longer a plan is, the less of it has the
    /// level that was measured before it. In the end its mean power is that of another drive. So the
    /// variance between drives is added, in the share of the plan that is beyond the horizon.
    pub(crate) fn errors_within(&self, duration_s: f32, middle: f32, half: f32) -> [f32; KNOTS] {
        let errors = self.known_errors(duration_s);
        let (trained_middle, trained_half) = quantiles::middle_and_half(&errors);
        // The trained interval has the trained bits.
        let moved = trained_half * middle;
        let beyond = self.share_beyond(duration_s);
        if beyond == 0.0 {
            return errors.map(|error| error + moved + (half - 1.0) * (error - trained_middle));
        }
        let wide = extrapolated(half * trained_half, beyond);
        if trained_half > LEAST_HALF {
            let factor = wide / trained_half;
            return errors.map(|error| trained_middle + moved + factor * (error - trained_middle));
        }
        Self::widened([trained_middle + moved; KNOTS], wide)
    }

    /// Share of a duration that is beyond the longest horizon whose errors are known.
    pub(crate) fn share_beyond(&self, duration_s: f32) -> f32 {
        let longest_s = self.longest_s();
        if longest_s > 0.0 { (1.0 - longest_s / duration_s).max(0.0) } else { 0.0 }
    }

    /// Quantiles of the error at a horizon, and beyond the longest known one those of that.
    pub(crate) fn known_errors(&self, horizon_s: f32) -> [f32; KNOTS] {
        let longest_s = self.longest_s();
        self.errors_at(if longest_s > 0.0 { horizon_s.min(longest_s) } else { horizon_s })
    }

    /// Quantiles widened about their middle to a half width of the 90 % interval, if they are
    /// narrower.
    pub(crate) fn widened(errors: [f32; KNOTS], wide: f32) -> [f32; KNOTS] {
        let (middle, half) = quantiles::middle_and_half(&errors);
        match wide > half {
            false => errors,
            true if half > LEAST_HALF => {
                errors.map(|error| middle + wide / half * (error - middle))
            }
            // Errors without width have no shape. That of a normal distribution stands for it.
            true => NORMAL.map(|part| middle + wide * part),
        }
    }

    /// Quantiles of the error at a horizon, linear between the known ones.
    pub(crate) fn errors_at(&self, horizon_s: f32) -> [f32; KNOTS] {
        between(&self.errors, horizon_s)
    }
}

/// Half width of the 90 % interval, relative, of a plan or outlook with this share beyond the longest
/// horizon whose errors are known. `known`: the half width there.
#[inline(always)]
pub(crate) fn extrapolated(known: f32, beyond: f32) -> f32 {
    let between = known.max(BETWEEN_DRIVES);
    (known * known + between * between * beyond).sqrt()
}

/// Rows at the horizons, linear between them and constant beyond.
#[inline(always)]
fn between<const N: usize>(rows: &[[f32; N]; HORIZONS], horizon_s: f32) -> [f32; N] {
    let last = HORIZONS - 2;
    let segment = (0..last).find(|index| horizon_s < HORIZONS_S[index + 1]).unwrap_or(last);
    let (from_s, to_s) = (HORIZONS_S[segment], HORIZONS_S[segment + 1]);
    let share = ((horizon_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    std::array::from_fn(|index| {
        let (from, to) = (rows[segment][index], rows[segment + 1][index]);
        from + share * (to - from)
    })
}
