//! Observations of a robot.

use crate::quantity::Quantity;

/// One observation of a robot, in SI units. NaN where it is unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Time, s since any start.
    pub time_s: f64,
    /// Commanded linear velocity, m/s.
    pub v_mps: f64,
    /// Commanded angular velocity, rad/s.
    pub omega_radps: f64,
    /// Measured linear velocity, m/s.
    pub v_measured_mps: f64,
    /// Measured angular velocity, rad/s.
    pub omega_measured_radps: f64,
    /// Electrical power, W.
    pub power_w: f64,
    /// Battery voltage, V.
    pub voltage_v: f64,
    /// Battery current, A.
    pub current_a: f64,
    /// State of charge, 0 to 1.
    pub soc: f64,
    /// True if it is on a charger, if that is known.
    pub charging: Option<bool>,
}

impl Observation {
    /// An observation at a time, with nothing known.
    #[must_use]
    pub const fn at(time_s: f64) -> Self {
        Self {
            time_s,
            v_mps: f64::NAN,
            omega_radps: f64::NAN,
            v_measured_mps: f64::NAN,
            omega_measured_radps: f64::NAN,
            power_w: f64::NAN,
            voltage_v: f64::NAN,
            current_a: f64::NAN,
            soc: f64::NAN,
            charging: None,
        }
    }

    /// The value of a quantity.
    #[must_use]
    pub const fn value(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::Power => self.power_w,
            Quantity::Voltage => self.voltage_v,
            Quantity::Current => self.current_a,
            Quantity::Soc => self.soc,
            Quantity::V => self.v_mps,
            Quantity::Omega => self.omega_radps,
        }
    }

    /// The same, to change it.
    pub const fn value_mut(&mut self, quantity: Quantity) -> &mut f64 {
        match quantity {
            Quantity::Power => &mut self.power_w,
            Quantity::Voltage => &mut self.voltage_v,
            Quantity::Current => &mut self.current_a,
            Quantity::Soc => &mut self.soc,
            Quantity::V => &mut self.v_mps,
            Quantity::Omega => &mut self.omega_radps,
        }
    }
}
