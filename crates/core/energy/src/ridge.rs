//! A ridge regression of the power on commands, for plans whose robot has shown little yet, and for
//! commands that the training data lacks.
//!
//! The command model's power is that of a robot whose level is measured. Its terms cannot lower the
//! power, and its fit leaves the differences between stretches of a recording to their levels. Both
//! are wrong for a skid-steer robot that is asked before it departs: the faster its arc, the less
//! it draws. The ridge regression has free signs and one level.

use serde::{Deserialize, Serialize};

use crate::command::{CommandModel, Motion};

/// Terms of the regression: those of the [command model](CommandModel::terms) that depend on v and
/// ω alone, without the constant.
pub const RIDGE_TERMS: usize = 7;
/// Seconds of readings after which the measured level counts as much as the regression, where both
/// are as exact.
const START_S: f32 = 3.0;
/// Seconds of readings after which half of the distance of a robot's level counts. Slow driving counts
/// as few of them, and rest as none.
const LEVEL_S: f32 = 0.3;
/// Weight of the square of that distance, in the deviation of the power of left-out drives: at half a
/// deviation the regression counts half.
const APART: f32 = 4.0;
/// Greatest deviation of the regression outside its training, in its deviation inside.
const MAX_SPREAD: f32 = 4.0;
/// Factor of the regression's share in the power of commands outside the training data. It errs by −48 to
/// 125 % at twice the training's speed, the command model by −17 to 60 %, with opposite signs.
pub(crate) const OUTSIDE_SHARE: f32 = 0.5;

/// Terms of a command that are weighted, or their distances from the training's means.
type Terms = [f32; RIDGE_TERMS];

/// A ridge regression, with the inverse that judges how far a command lies from its training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ridge {
    /// Power at the means of the terms, W.
    pub constant_w: f32,
    /// Mean of each term in the training data.
    pub means: Terms,
    /// Deviation of each term in the training data, above 0. 0.1 for a term that is constant there.
    pub scales: Terms,
    /// Power of one deviation of each term, W.
    pub weights: Terms,
    /// Inverse of the terms' correlations, whose diagonal the penalty has raised.
    pub inverse: [Terms; RIDGE_TERMS],
    /// Greatest leverage in the training data, above 0.
    pub max_leverage: f32,
    /// Half width of the 90 % interval of the power of a drive that the training data lacks,
    /// relative, as drives that were left out by turns show it.
    pub left_out: f32,
}

impl Ridge {
    /// Share of the regression in a plan of a robot with `time_s` seconds of readings, which drew this
    /// `level` in what the command model says of them. `half`: half width of the 90 % interval of the
    /// model with a level, relative.
    ///
    /// The regression has the level of its training. On another floor it errs by what the robot's level
    /// is apart from that.
    pub(crate) fn share(&self, (time_s, level): (f32, f32), half: f32) -> f32 {
        let left_out = self.left_out.max(f32::MIN_POSITIVE);
        let exact = (half / left_out).min(1.0);
        let start_s = START_S * exact * exact;
        let apart = time_s / (time_s + LEVEL_S) * (level - 1.0) / (left_out / 1.645);
        let known = time_s > 0.0 && apart.is_finite();
        if known { start_s / (start_s + time_s) / (1.0 + APART * apart * apart) } else { 1.0 }
    }

    /// Distances of a command from the training's means, in deviations.
    #[inline(always)]
    pub fn deviations(&self, command: &CommandModel, v_mps: f32, omega_radps: f32) -> Terms {
        let terms = command.terms([v_mps, omega_radps, 0.0, 0.0]);
        std::array::from_fn(|term| (terms[term + 1] - self.means[term]) / self.scales[term])
    }

    /// Power of a command, W, not bounded.
    #[inline(always)]
    pub fn power_w(&self, deviations: &Terms) -> f32 {
        let mut power_w = self.constant_w;
        for (weight, deviation) in self.weights.iter().zip(deviations) {
            power_w += weight * deviation;
        }
        power_w
    }

    /// Leverage of a command: how far it lies from those of the training data, 1 for the farthest
    /// of them.
    #[inline(always)]
    pub fn leverage(&self, deviations: &Terms) -> f32 {
        let mut leverage = 0.0;
        for (row, one) in self.inverse.iter().zip(deviations) {
            let mut sum = 0.0;
            for (cell, other) in row.iter().zip(deviations) {
                sum += cell * other;
            }
            leverage += one * sum;
        }
        leverage / self.max_leverage
    }

    /// Deviation of the power of a command with this leverage, in that of the farthest one of the
    /// training data.
    pub(crate) fn spread(leverage: f32) -> f32 {
        leverage.max(1.0).sqrt().min(MAX_SPREAD)
    }

    /// Derivatives of the power with respect to v and ω, as [`CommandModel::slopes`] has them.
    pub(crate) fn slopes(&self, command: &CommandModel, motion: &Motion) -> [f32; 2] {
        let mut of_terms = CommandModel { weights: [0.0; crate::TERMS], ..*command };
        for term in 0..RIDGE_TERMS {
            of_terms.weights[term + 1] = self.weights[term] / self.scales[term];
        }
        let still = Motion { dv_mps2: 0.0, domega_radps2: 0.0, ..*motion };
        let [by_v, by_omega, ..] = of_terms.slopes(&still);
        [by_v, by_omega]
    }
}

/// What lies outside the training data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// The linear velocity, m/s.
    Velocity,
    /// The angular velocity, rad/s.
    AngularVelocity,
    /// Product of the linear velocity and its change, m²/s³.
    Acceleration,
    /// Product of the angular velocity and its change, rad²/s³.
    AngularAcceleration,
    /// Change of the linear velocity, m/s².
    VelocityChange,
    /// Change of the angular velocity, rad/s².
    AngularVelocityChange,
    /// Both velocities together: their distance from those of the training data, in that of the
    /// farthest of these.
    Together,
}

impl Quantity {
    /// All, by their codes from 1.
    pub const ALL: [Self; 7] = [
        Self::Velocity,
        Self::AngularVelocity,
        Self::Acceleration,
        Self::AngularAcceleration,
        Self::VelocityChange,
        Self::AngularVelocityChange,
        Self::Together,
    ];

    /// Its name and its unit, as an answer states them.
    pub const fn words(self) -> [&'static str; 2] {
        match self {
            Self::Velocity => ["v", " m/s"],
            Self::AngularVelocity => ["ω", " rad/s"],
            Self::Acceleration => ["v·dv/dt", " m²/s³"],
            Self::AngularAcceleration => ["ω·dω/dt", " rad²/s³"],
            Self::VelocityChange => ["|dv/dt|", " m/s²"],
            Self::AngularVelocityChange => ["|dω/dt|", " rad/s²"],
            Self::Together => ["the distance of v and ω together from the training", ""],
        }
    }
}

/// A quantity of a plan that the training data lacks: that which would need the greatest change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outside {
    /// The quantity.
    pub quantity: Quantity,
    /// Its value in the plan.
    pub value: f32,
    /// Its range in the training data.
    pub known: [f32; 2],
    /// Greatest speed of the plan at which this quantity would be inside, m/s. `None` if no lower
    /// speed would do, for instance for a turn on the spot.
    pub inside_at_mps: Option<f32>,
}
