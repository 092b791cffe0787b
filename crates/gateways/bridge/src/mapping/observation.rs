//! The observation of one robot in one message.

use joulebus_plausibility::Mapped;
pub(crate) use joulebus_plausibility::PowerOf;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PowerReading {
    /// The power, W, positive out of the battery.
    pub(crate) power_w: f32,
    pub(crate) of: PowerOf,
}

/// The values of a message in SI. `None` if the message does not have the value. All numbers are
/// finite.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Observation {
    pub(crate) v_mps: Option<f32>,
    pub(crate) omega_radps: Option<f32>,
    pub(crate) power: Option<PowerReading>,
    pub(crate) power_of_current: bool,
    pub(crate) voltage_v: Option<f32>,
    /// Battery current, A, positive while discharging.
    pub(crate) current_a: Option<f32>,
    /// The current is the number that drivers of its format write where they measure none.
    pub(crate) is_reserved: bool,
    /// State of charge, 0 to 1.
    pub(crate) soc: Option<f32>,
    pub(crate) charging: Option<bool>,
    /// True if the charger reports a full battery.
    pub(crate) full: Option<bool>,
    pub(crate) swapped: Option<bool>,
    /// True if there is no battery in the robot: one that comes back is another.
    pub(crate) removed: Option<bool>,
    /// True if the robot says that it is switched off. No other value tells anything.
    pub(crate) off: Option<bool>,
    /// Messages of its kind report whether the robot charges.
    pub(crate) reports_charging: bool,
    /// The robot says that it is gone, or its broker does.
    pub(crate) has_ended: bool,
    /// It is of one pack of several, with its number: the sum counts.
    pub(crate) pack: Option<(usize, Mapped)>,
}

impl Observation {
    pub(crate) fn of(mapped: &Mapped) -> Self {
        let number = |value: f64| (!value.is_nan()).then_some(value as f32);
        let seen = &mapped.seen;
        Self {
            v_mps: number(seen.v_mps),
            omega_radps: number(seen.omega_radps),
            power: number(seen.power_w)
                .map(|power_w| PowerReading { power_w, of: mapped.power_of }),
            power_of_current: mapped.is_product,
            voltage_v: number(seen.voltage_v),
            current_a: number(seen.current_a),
            is_reserved: mapped.is_reserved,
            soc: number(seen.soc),
            charging: seen.charging,
            full: mapped.full,
            ..Self::default()
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        let said = Self {
            power_of_current: false,
            is_reserved: false,
            reports_charging: false,
            off: self.off.filter(|is_off| *is_off),
            ..*self
        };
        said == Self::default()
    }
}
