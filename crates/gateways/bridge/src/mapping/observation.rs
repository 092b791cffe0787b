//! The observation of one robot in one message.

/// A power, and what it measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PowerReading {
    /// The power, W, positive out of the battery.
    pub(crate) power_w: f32,
    /// The flow that was measured.
    pub(crate) of: PowerOf,
}

/// The flow that a power meter measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PowerOf {
    /// The robot's consumption.
    #[default]
    Load,
    /// The battery's discharge, negative while it is charged.
    Battery,
}

/// The values of a message in SI. `None` if the message does not have the value. All numbers are
/// finite.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Observation {
    /// Linear velocity, m/s.
    pub(crate) v_mps: Option<f32>,
    /// Angular velocity, rad/s.
    pub(crate) omega_radps: Option<f32>,
    /// Power.
    pub(crate) power: Option<PowerReading>,
    /// The power is voltage times current.
    pub(crate) power_of_current: bool,
    /// Battery voltage, V.
    pub(crate) voltage_v: Option<f32>,
    /// Battery current, A, positive while discharging.
    pub(crate) current_a: Option<f32>,
    /// The current is the number that drivers of its format write where they measure none.
    pub(crate) is_reserved: bool,
    /// State of charge, 0 to 1.
    pub(crate) soc: Option<f32>,
    /// Whether the robot is on its charger.
    pub(crate) charging: Option<bool>,
    /// True if the charger reports a full battery.
    pub(crate) full: Option<bool>,
    /// Messages of its kind report whether the robot charges.
    pub(crate) reports_charging: bool,
    /// The message is known to repeat the previous measurement.
    pub(crate) repeats: bool,
}

impl Observation {
    /// True if it has no value.
    pub(crate) fn is_empty(&self) -> bool {
        let Self {
            v_mps,
            omega_radps,
            power,
            power_of_current: _,
            voltage_v,
            current_a,
            is_reserved: _,
            soc,
            charging,
            full,
            reports_charging: _,
            repeats: _,
        } = self;
        let numbers = [v_mps, omega_radps, voltage_v, current_a, soc];
        numbers.iter().all(|number| number.is_none())
            && power.is_none()
            && charging.is_none()
            && full.is_none()
    }
}
