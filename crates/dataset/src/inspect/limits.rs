//! What a value may be.

use serde::Serialize;

use crate::trial::Column;

/// From the least to the greatest value that can be true.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Range {
    /// The least.
    pub least: f64,
    /// The greatest.
    pub greatest: f64,
}

impl Range {
    /// Everything up to `greatest` in both directions.
    #[must_use]
    pub const fn within(greatest: f64) -> Self {
        Self {
            least: -greatest,
            greatest,
        }
    }

    pub(super) fn holds(self, value: f64) -> bool {
        (self.least..=self.greatest).contains(&value)
    }
}

/// What is called wrong. Past these bounds a wheeled robot's recording is more likely mistaken, in a
/// wrong unit for instance, than true; a platform's own limits are narrower.
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
    /// Battery voltage, V.
    pub voltage_v: Range,
    /// Battery current, A.
    pub current_a: Range,
    /// Electrical power, W; negative where it is fed back.
    pub power_w: Range,
    /// How far power may be from voltage times current, as a share of it.
    pub power_share: f64,
    /// How far it may be at least, W: a few steps of the power monitor.
    pub power_step_w: f64,
    /// Time for which a reading may stand before the sensor is called stuck, s.
    pub stuck_s: f64,
    /// And how many times as long as readings usually stand.
    pub stuck_holds: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            v_mps: Range::within(10.0),
            omega_radps: Range::within(50.0),
            position_m: Range::within(100_000.0),
            theta_rad: Range::within(1_000.0),
            voltage_v: Range {
                least: 0.0,
                greatest: 1_000.0,
            },
            current_a: Range::within(1_000.0),
            power_w: Range::within(100_000.0),
            power_share: 0.05,
            power_step_w: 0.03,
            stuck_s: 10.0,
            stuck_holds: 20,
        }
    }
}

impl Limits {
    /// The range of a column in SI units; none for a column that may be anything.
    #[must_use]
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
        }
    }
}
