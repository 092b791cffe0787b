//! Fusion of a measured state of charge with the counted one.
//!
//! A Kalman filter of two numbers: the state of charge, and the persistent error of the sensor.
//! Without the second, thirty readings a second of one sensor would count as many sensors, and the
//! uncertainty would vanish after a minute. The error of the power monitor is a third, which the
//! filter considers but does not estimate (Schmidt): it keeps its sign over all readings. It uses only sums, products and square roots: the same
//! bits on every machine.

use joulebus_wire::{Alarm, AlarmSet};

use crate::ledger::battery::BatteryState;
use crate::ledger::measured::Measured;

/// Minimum time between two measured values that are used, ns. More frequent ones are redundant.
const EVERY_NS: u64 = 1_000_000_000;
/// Time constant of the sensor's error, s.
const BIAS_S: f64 = 3600.0;
/// A measured value this many standard deviations off contradicts the estimate.
const GATE: f64 = 4.0;
/// Steps by which a measured value must fall before an unexplained rise is believed.
const FALLS: f64 = 2.0;
/// Steps, and share beyond them, within which contradicting values agree with each other.
const AGREES: (f64, f64) = (2.0, 0.02);
/// Steps, and standard deviations beyond them, that the charge may change under an unchanged value.
const STUCK: (f64, f64) = (3.0, 1.0);
/// Time for which contradicting values must agree: after an interruption, and otherwise, ns.
const AFTER_GAP_NS: u64 = 10_000_000_000;
const LASTS_NS: u64 = 60_000_000_000;

/// Errors of the sensor: variance, and covariance with the state of charge.
pub(crate) struct SensorError {
    pub var: f64,
    pub covariance: f64,
}

impl BatteryState {
    /// True if a measured value of this stamp is used.
    #[inline(always)]
    pub(crate) fn is_due(&self, stamp_ns: u64) -> bool {
        let since_ns = stamp_ns.wrapping_sub(self.measured_ns);
        // Also if stamps began again.
        (self.measured_ns == 0) | (since_ns >= EVERY_NS)
    }

    /// Fuses a measured value with the estimate, unless it is stuck or contradicts the estimate.
    /// The anchor is at the sample. Returns whether it is believed.
    pub(crate) fn fuse(&mut self, measured: Measured, stamp_ns: u64) -> bool {
        self.age(measured.sd, stamp_ns);
        let implausible = self.is_stuck(measured) || self.contradicts(measured, stamp_ns);
        let raised = AlarmSet(self.raised);
        self.raised = match implausible {
            true => raised.with(Alarm::SocImplausible).0,
            false => raised.without(Alarm::SocImplausible).0,
        };
        !implausible
    }

    /// True if the last measured value is below the counted one, and is not believed.
    pub(crate) fn is_contradicted(&self) -> bool {
        AlarmSet(self.raised).has(Alarm::SocImplausible) && self.jump < 0.0
    }

    /// The sensor's error changes with time.
    fn age(&mut self, sd: f64, stamp_ns: u64) {
        let elapsed_s = match self.measured_ns {
            0 => 0.0,
            before_ns => stamp_ns.saturating_sub(before_ns) as f64 * 1e-9,
        };
        if !self.fused {
            self.bias_var = sd * sd;
        }
        let stays = BIAS_S / (BIAS_S + elapsed_s);
        self.bias *= stays;
        self.bias_monitor *= stays;
        self.covariance *= stays;
        self.bias_var = stays * stays * self.bias_var + (1.0 - stays * stays) * sd * sd;
        self.measured_ns = stamp_ns;
    }

    /// True if the value is the same although the charge has changed.
    fn is_stuck(&mut self, measured: Measured) -> bool {
        if measured.soc.to_bits() != self.measured.to_bits() {
            (self.measured, self.equal_counted) = (measured.soc, self.counted);
        }
        let (steps, deviations) = STUCK;
        let allowed = steps * measured.step + deviations * measured.sd;
        (self.counted - self.equal_counted).abs() > allowed
    }

    /// Fuses the value if it agrees with the estimate. If not, it replaces the estimate once it has
    /// agreed with the energy drawn for long enough: the battery is another one.
    fn contradicts(&mut self, measured: Measured, stamp_ns: u64) -> bool {
        let width = self.below + self.above;
        let soc = self.soc + 0.5 * (self.above - self.below);
        // Deviations are added, not variances: the robot may draw, or be charged with, the same
        // unknown power for hours.
        let sd = self.sd + width / 12f64.sqrt();
        let var = sd * sd;
        let off = measured.soc - soc - self.bias;
        let sensor = self.sensor();
        let of_soc = var + self.monitor * self.monitor + sensor.covariance;
        let of_bias = sensor.var + sensor.covariance;
        let innovation = (of_soc + of_bias).max(0.0) + measured.noise();
        let agrees = off * off <= GATE * GATE * innovation;
        if !agrees {
            return self.doubt(measured, stamp_ns);
        }
        let (gain, bias_gain) = (of_soc / innovation, of_bias / innovation);
        (self.below, self.above, self.range_sd, self.jump) = (0.0, 0.0, 0.0, f64::NAN);
        (self.pause_s, self.pause) = (0.0, 0.0);
        self.soc = (soc + gain * off).clamp(0.0, 1.0);
        self.bias = (self.bias + bias_gain * off).clamp(-1.0, 1.0);
        self.update(var, (gain, bias_gain), measured.noise());
        self.fused = true;
        false
    }

    /// Errors after a measured value with these gains. `var` is that of the charge before.
    fn update(&mut self, var: f64, (gain, bias_gain): (f64, f64), noise: f64) {
        let (stays, bias_stays) = (1.0 - gain, 1.0 - bias_gain);
        let (bias_var, covariance) = (self.bias_var, self.covariance);
        // Right for any gains: these are the best ones only with the monitor's part.
        let own_var = stays * stays * var + gain * gain * (bias_var + noise)
            - 2.0 * stays * gain * covariance;
        self.bias_var = bias_gain * bias_gain * (var + noise) + bias_stays * bias_stays * bias_var
            - 2.0 * bias_gain * bias_stays * covariance;
        self.covariance = (stays * bias_stays + gain * bias_gain) * covariance
            - stays * bias_gain * var
            - gain * bias_stays * bias_var
            + gain * bias_gain * noise;
        (self.sd, self.bias_var) = (own_var.max(0.0).sqrt(), self.bias_var.max(0.0));
        let both = self.monitor + self.bias_monitor;
        self.monitor -= gain * both;
        self.bias_monitor -= bias_gain * both;
    }

    /// Errors of the sensor, with the monitor's part of them.
    pub(crate) fn sensor(&self) -> SensorError {
        SensorError {
            var: self.bias_var + self.bias_monitor * self.bias_monitor,
            covariance: self.covariance + self.monitor * self.bias_monitor,
        }
    }

    /// A value that contradicts the estimate. Returns whether it still does.
    fn doubt(&mut self, measured: Measured, stamp_ns: u64) -> bool {
        let jump = measured.soc - self.soc;
        let agrees = (jump - self.jump).abs() <= AGREES.0 * measured.step + AGREES.1;
        // Also false without a measured value, which is NaN.
        if !agrees {
            (self.jump, self.jump_ns, self.jump_measured) = (jump, stamp_ns, measured.soc);
        }
        let lasted_ns = stamp_ns.saturating_sub(self.jump_ns);
        let interrupted = self.jump_ns.saturating_sub(self.interrupted_ns) <= LASTS_NS;
        let falls = self.jump_measured - measured.soc >= FALLS * measured.step;
        let believed = match (interrupted, jump < 0.0 || falls) {
            (true, _) => lasted_ns >= AFTER_GAP_NS,
            (false, true) => lasted_ns >= LASTS_NS,
            // No battery fills while it is driven. Only a failing sensor reports that.
            (false, false) => false,
        };
        if believed {
            // The state before the first measured value was only assumed.
            self.changes = self.changes.saturating_add(u32::from(self.fused));
            self.believe(measured);
        }
        !believed
    }

    /// The measured value is all that is known.
    fn believe(&mut self, measured: Measured) {
        let bias_var = measured.sd * measured.sd;
        self.soc = measured.soc;
        self.sd = (bias_var + measured.noise()).sqrt();
        (self.below, self.above, self.range_sd, self.jump) = (0.0, 0.0, 0.0, f64::NAN);
        (self.bias, self.bias_var, self.covariance) = (0.0, bias_var, -bias_var);
        (self.pause_s, self.pause) = (0.0, 0.0);
        (self.monitor, self.bias_monitor) = (0.0, 0.0);
        self.lessons.end();
        self.lessons.charge(None, None);
        self.fused = true;
    }
}
