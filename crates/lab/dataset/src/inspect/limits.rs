//! Plausible ranges of recorded values.

use serde::Serialize;

use crate::trial::Column;

/// A plausible range, ends included.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Range {
    /// Minimum.
    pub least: f64,
    /// Maximum.
    pub greatest: f64,
}

impl Range {
    /// The range from `-greatest` to `greatest`.
    pub const fn within(greatest: f64) -> Self {
        Self { least: -greatest, greatest }
    }

    pub(super) fn holds(self, value: f64) -> bool {
        (self.least..=self.greatest).contains(&value)
    }
}

/// Thresholds of the check. Values beyond them are more likely recording errors, such as a wrong
/// unit, than measurements of a wheeled robot. A platform's own limits are narrower.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limits {
    /// Commanded and measured linear velocity, m/s.
    pub v_mps: Range,
    /// Commanded and measured angular velocity, rad/s.
    pub omega_radps: Range,
    /// Position, m.
    pub position_m: Range,
    /// Heading, rad: many turns, if it was recorded unwrapped.
    pub theta_rad: Range,
    /// Heading, rad: many turns if recorded unwrapped.
    pub voltage_v: Range,
    /// Battery current, A.
    pub current_a: Range,
    /// Electrical power, W. Negative while regenerating.
    pub power_w: Range,
    /// Measured state of charge. Batteries report a little more than full.
    pub soc: Range,
    /// Allowed difference between power and voltage times current, as a share of the latter.
    pub power_share: f64,
    /// Allowed difference at least, W: a few steps of the power monitor.
    pub power_step_w: f64,
    /// Time for which a reading may be held before the sensor is reported as stuck, s.
    pub stuck_s: f64,
    /// Minimum length of a stuck reading, in multiples of the usual hold.
    pub stuck_holds: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            v_mps: Range::within(10.0),
            omega_radps: Range::within(50.0),
            position_m: Range::within(100_000.0),
            theta_rad: Range::within(1_000.0),
            voltage_v: Range { least: 0.0, greatest: 1_000.0 },
            current_a: Range::within(1_000.0),
            power_w: Range::within(100_000.0),
            soc: Range { least: -0.05, greatest: 1.05 },
            power_share: 0.05,
            power_step_w: 0.03,
            stuck_s: 10.0,
            stuck_holds: 20,
        }
    }
}

impl Limits {
    /// The range of a column in SI units. `None` for an unbounded column.
    pub const fn range(&self, column: Column) -> Option<Range> {
        match column {
            Column::Phase => None,
            Column::V | Column::VMeasured => Some(self.v_mps),
            Column::Omega | Column::OmegaMeasured => Some(self.omega_radps),
            Column::X | Column::Y => Some(self.position_m),
            Column::Theta => Some(self.theta_rad),
            Column::Voltage => Some(self.voltage_v),
            Column::Current => Some(self.current_a),
            Column::Power => Some(self.power_w),
            Column::Soc => Some(self.soc),
        }
    }
}
