//! Units of the numbers in messages.

use std::f64::consts::PI;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Quantity {
    Power,
    Voltage,
    Current,
    Share,
    Speed,
    TurnRate,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unit {
    pub(crate) name: &'static str,
    pub(crate) size: f64,
}

impl Unit {
    /// True for a unit of a share, whose numbers are mapped as they are.
    pub(crate) fn measures_share(&self) -> bool {
        Quantity::Share.units().iter().any(|(name, _)| *name == self.name)
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{found:?} is no unit of {quantity}, allowed are {allowed}")]
pub(crate) struct UnitError {
    found: String,
    quantity: &'static str,
    allowed: String,
}

impl Quantity {
    const fn name(self) -> &'static str {
        match self {
            Self::Power => "a power",
            Self::Voltage => "a voltage",
            Self::Current => "a current",
            Self::Share => "a share",
            Self::Speed => "a speed",
            Self::TurnRate => "a turn rate",
        }
    }

    /// The quantity's units, the SI unit first.
    const fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Power => &[("W", 1.0), ("mW", 1e-3), ("kW", 1e3)],
            Self::Voltage => &[("V", 1.0), ("mV", 1e-3)],
            Self::Current => &[("A", 1.0), ("mA", 1e-3)],
            Self::Share => &[("share", 1.0), ("%", 0.01)],
            Self::Speed => &[("m/s", 1.0), ("mm/s", 1e-3), ("cm/s", 1e-2), ("km/h", 1.0 / 3.6)],
            Self::TurnRate => &[("rad/s", 1.0), ("deg/s", PI / 180.0)],
        }
    }

    pub(crate) const fn si(self) -> Unit {
        let (name, size) = self.units()[0];
        Unit { name, size }
    }

    pub(crate) fn unit(self, name: &str) -> Result<Unit, UnitError> {
        let found = self.units().iter().find(|(unit, _)| *unit == name);
        let unit = found.map(|(name, size)| Unit { name, size: *size });
        unit.ok_or_else(|| UnitError {
            found: name.to_owned(),
            quantity: self.name(),
            allowed: self.units().iter().map(|(unit, _)| *unit).collect::<Vec<_>>().join(", "),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_those_of_their_quantity_alone() {
        for (quantity, name, size) in [
            (Quantity::Power, "mW", 1e-3),
            (Quantity::Share, "%", 0.01),
            (Quantity::TurnRate, "deg/s", PI / 180.0),
            (Quantity::Speed, "km/h", 1.0 / 3.6),
        ] {
            assert_eq!(quantity.unit(name).unwrap().size, size, "{name}");
        }
        for (quantity, name) in
            [(Quantity::Power, "mA"), (Quantity::Power, "MW"), (Quantity::Share, "m")]
        {
            let refused = quantity.unit(name).unwrap_err().to_string();
            assert!(refused.contains("allowed are"), "{refused}");
        }
    }
}
