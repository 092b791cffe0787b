//! The power of a command, independent of the readings.

use serde::{Deserialize, Serialize};

/// Terms of the command model.
pub const TERMS: usize = 12;

/// Terms of two quantities or of a change: the last of the [`TERMS`].
pub const COMBINED_TERMS: usize = 5;

/// The power that a platform draws under a command: a weighted sum of [`TERMS`] terms that are
/// never negative.
///
/// The terms are 1; |v|, v², |v|/(|v| + v₀); |ω|, ω², |ω|/(|ω| + ω₀); |vω|; the products of v and
/// of ω with their derivatives where positive (power to accelerate); the absolute derivatives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandModel {
    /// Weight of each term, W per unit of the term, not negative.
    pub weights: [f32; TERMS],
    /// v₀, m/s, above 0.
    pub half_v_mps: f32,
    /// ω₀, rad/s, above 0.
    pub half_omega_radps: f32,
    /// Mean power in the training data, and of an unknown command, W, above 0.
    pub mean_w: f32,
}

/// A command and the change that led to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion {
    pub v_mps: f32,
    pub omega_radps: f32,
    pub dv_mps2: f32,
    pub domega_radps2: f32,
}

impl Motion {
    /// `previous`: the command before and the seconds between the two. Without them, or if one of
    /// them is not finite, there is no change.
    #[inline(always)]
    pub(crate) fn new((v_mps, omega_radps): (f32, f32), previous: (f32, f32), dt_s: f32) -> Self {
        let (dv, domega) = (v_mps - previous.0, omega_radps - previous.1);
        let known = (dt_s > 0.0) & dv.is_finite() & domega.is_finite();
        let per_s = 1.0 / if known { dt_s } else { 1.0 };
        Self {
            v_mps,
            omega_radps,
            dv_mps2: if known { dv * per_s } else { 0.0 },
            domega_radps2: if known { domega * per_s } else { 0.0 },
        }
    }
}

impl Motion {
    #[inline(always)]
    pub(crate) const fn to_array(self) -> [f32; 4] {
        [self.v_mps, self.omega_radps, self.dv_mps2, self.domega_radps2]
    }

    /// True if the command is finite.
    #[inline(always)]
    pub(crate) fn is_known(&self) -> bool {
        self.v_mps.is_finite() & self.omega_radps.is_finite()
    }
}

impl CommandModel {
    /// The same power under every command.
    pub fn constant(power_w: f32) -> Self {
        let mut weights = [0.0; TERMS];
        weights[0] = power_w;
        Self { weights, half_v_mps: 1.0, half_omega_radps: 1.0, mean_w: power_w }
    }

    /// True if the command makes a difference.
    pub fn reads_commands(&self) -> bool {
        self.weights[1..].iter().any(|weight| *weight != 0.0)
    }

    /// The terms of a command: velocities in m/s and rad/s, their derivatives in m/s² and rad/s².
    #[inline(always)]
    pub fn terms(&self, motion: [f32; 4]) -> [f32; TERMS] {
        let (v, omega) = (motion[0].abs(), motion[1].abs());
        let [turning, faster_v, faster_omega, dv, domega] = Self::combined_terms(motion);
        [
            1.0,
            v,
            v * v,
            v / (v + self.half_v_mps),
            omega,
            omega * omega,
            omega / (omega + self.half_omega_radps),
            turning,
            faster_v,
            faster_omega,
            dv,
            domega,
        ]
    }

    /// The last of these terms, without any weight or constant: |vω|; v dv/dt and ω dω/dt where
    /// positive; |dv/dt|; |dω/dt|.
    #[inline(always)]
    pub fn combined_terms(motion: [f32; 4]) -> [f32; COMBINED_TERMS] {
        let [v_mps, omega_radps, dv_mps2, domega_radps2] = motion;
        [
            v_mps.abs() * omega_radps.abs(),
            (v_mps * dv_mps2).max(0.0),
            (omega_radps * domega_radps2).max(0.0),
            dv_mps2.abs(),
            domega_radps2.abs(),
        ]
    }

    /// Power in W. That without a command for one that is not finite.
    #[inline(always)]
    pub(crate) fn power_w(&self, motion: &Motion) -> f32 {
        let terms = self.terms(motion.to_array());
        let mut power_w = 0.0;
        for (weight, term) in self.weights.iter().zip(terms) {
            power_w += weight * term;
        }
        if power_w.is_finite() & motion.is_known() { power_w } else { self.mean_w }
    }

    /// Derivatives of the power with respect to v, ω, dv/dt and dω/dt. Where a term has a corner,
    /// the derivative towards greater values. At rest 0.
    pub(crate) fn slopes(&self, motion: &Motion) -> [f32; 4] {
        let sign = |value: f32| match value {
            _ if value > 0.0 => 1.0,
            _ if value < 0.0 => -1.0,
            _ => 0.0,
        };
        let w = &self.weights;
        let (v, omega) = (motion.v_mps.abs(), motion.omega_radps.abs());
        let (half_v, half_omega) = (self.half_v_mps, self.half_omega_radps);
        let saturating = |value: f32, half: f32| half / ((value + half) * (value + half));
        let gains_v = if motion.v_mps * motion.dv_mps2 > 0.0 { w[8] } else { 0.0 };
        let gains_omega = if motion.omega_radps * motion.domega_radps2 > 0.0 { w[9] } else { 0.0 };
        let by_v = w[1] + 2.0 * w[2] * v + w[3] * saturating(v, half_v) + w[7] * omega;
        let by_omega = w[4] + 2.0 * w[5] * omega + w[6] * saturating(omega, half_omega) + w[7] * v;
        [
            sign(motion.v_mps) * by_v + gains_v * motion.dv_mps2,
            sign(motion.omega_radps) * by_omega + gains_omega * motion.domega_radps2,
            gains_v * motion.v_mps + w[10] * sign(motion.dv_mps2),
            gains_omega * motion.omega_radps + w[11] * sign(motion.domega_radps2),
        ]
    }
}
