//! Quantities that are judged, in SI units.

use serde::Serialize;

/// The current that drivers of `sensor_msgs/BatteryState` write where they measure none, A.
pub const UNMEASURED_A: f64 = -1.0;

/// A quantity of an [`Observation`](crate::Observation).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Electrical power, W, positive while the battery discharges.
    Power,
    /// Battery voltage, V.
    Voltage,
    /// Battery current, A, positive while the battery discharges.
    Current,
    /// State of charge, 0 to 1.
    Soc,
    /// Commanded linear velocity, m/s.
    V,
    /// Commanded angular velocity, rad/s.
    Omega,
}

/// Names, units, and their thousandths where tables have them, in the order of [`Quantity`].
const NAMES: [(&str, &str, &str); 6] = [
    ("power", "W", "mW"),
    ("voltage", "V", "mV"),
    ("current", "A", "mA"),
    ("soc", "", ""),
    ("v", "m/s", "m/s"),
    ("omega", "rad/s", "rad/s"),
];

impl Quantity {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 6] =
        [Self::Power, Self::Voltage, Self::Current, Self::Soc, Self::V, Self::Omega];

    /// The name in messages and in a mapping.
    #[must_use]
    pub const fn name(self) -> &'static str {
        NAMES[self as usize].0
    }

    /// The unit of its values here.
    pub(crate) const fn unit(self) -> &'static str {
        NAMES[self as usize].1
    }

    /// A thousandth of that unit, where tables have it.
    pub(crate) const fn milli(self) -> &'static str {
        NAMES[self as usize].2
    }

    pub(crate) fn shown(self, value: f64) -> String {
        let number = number(value);
        match self.unit() {
            "" => number,
            unit => format!("{number} {unit}"),
        }
    }
}

/// Four significant digits without an exponent, where that is short.
pub(crate) fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        // Not that of a turned zero, which has a sign.
        return "0".to_owned();
    }
    if !value.is_finite() {
        return format!("{value}");
    }
    if !(1e-4..1e7).contains(&size) {
        return format!("{value:.3e}");
    }
    let decimals = (3 - size.log10().floor() as i32).clamp(0, 8) as usize;
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}
