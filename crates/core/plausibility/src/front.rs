//! What a message or a row says becomes one observation: one function for all formats.
//!
//! A format decodes into [`Said`], and [`Said::map`] decides what is known. So a speed with a part
//! across, a battery that is absent, a charge of −1 and an infinite number mean the same in a CSV,
//! an array, a capture, a bag, and in messages of MQTT, VDA 5050 and ROS 2.

use std::ops::RangeInclusive;

use serde::Deserialize;

use crate::observation::Observation;
use crate::quantity::UNMEASURED_A;

/// States of charge that the worker takes.
pub const SOC: RangeInclusive<f64> = -0.05..=1.05;

/// The flow that a power meter measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PowerOf {
    /// The robot's consumption.
    #[default]
    Load,
    /// The battery's discharge, negative while it is charged.
    Battery,
}

/// A number of a message or a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[expect(missing_docs, reason = "their names say it")]
pub enum Field {
    V,
    Vy,
    Omega,
    VMeasured,
    VyMeasured,
    OmegaMeasured,
    Power,
    Voltage,
    Current,
    Soc,
}

/// Numbers, in the order of [`Field`].
const FIELDS: [Field; 10] = [
    Field::V,
    Field::Vy,
    Field::Omega,
    Field::VMeasured,
    Field::VyMeasured,
    Field::OmegaMeasured,
    Field::Power,
    Field::Voltage,
    Field::Current,
    Field::Soc,
];

/// Reason that a number is not known, or in no sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unusable {
    /// It is infinite, or beyond what 32 bits hold in SI units.
    NotFinite,
    /// A charge outside [`SOC`]. It is judged all the same.
    OutOfRange,
    /// The number by which its format says that it does not know it.
    Unknown,
}

/// What one message or row says, with the signs of joulebus. NaN where it says nothing.
#[derive(Debug, Clone, Copy)]
pub struct Said {
    /// The numbers, in the order of [`Field`].
    pub numbers: [f64; FIELDS.len()],
    /// How many of the units of power are one unit of voltage times one of current: 1 in SI units,
    /// 1,000 in mV, mA and mW.
    pub product_units: f64,
    /// The share that is one unit of the charge: 0.01 of a percentage.
    pub soc_unit: f64,
    /// The current as its format writes it, where the format reserves −1 for one that is not
    /// measured. NaN elsewhere.
    pub written_a: f64,
    /// The flow that the power measures.
    pub power_of: PowerOf,
    /// The flow whose power is voltage times current, where there is no power.
    pub product_of: Option<PowerOf>,
    /// Whether there is a battery, if that is said. One with a voltage is there all the same.
    pub present: Option<bool>,
    /// Whether it is on its charger.
    pub charging: Option<bool>,
    /// Whether the charger reports a full battery.
    pub full: Option<bool>,
}

impl Default for Said {
    fn default() -> Self {
        Self {
            numbers: [f64::NAN; FIELDS.len()],
            product_units: 1.0,
            soc_unit: 1.0,
            written_a: f64::NAN,
            power_of: PowerOf::Load,
            product_of: None,
            present: None,
            charging: None,
            full: None,
        }
    }
}

/// What is known of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mapped {
    /// The values, NaN where they are unknown, in the units of what was said. The charge is a share.
    /// Its time is 0.
    pub seen: Observation,
    /// The power is voltage times current.
    pub is_product: bool,
    /// The flow that it measures.
    pub power_of: PowerOf,
    /// The current is the number that its format reserves for one that is not measured.
    pub is_reserved: bool,
    /// Whether the charger reports a full battery.
    pub full: Option<bool>,
}

impl Said {
    /// Sets a number. NaN is none.
    pub const fn set(&mut self, field: Field, value: f64) {
        self.numbers[field as usize] = value;
    }

    /// The same with a number.
    #[must_use]
    pub const fn with(mut self, field: Field, value: f64) -> Self {
        self.set(field, value);
        self
    }

    /// What is known. A number that cannot be used is passed to `refused`, and the others count.
    pub fn map(mut self, mut refused: impl FnMut(Field, Unusable)) -> Mapped {
        // Many drivers leave it false, and a battery that is not there has no voltage.
        let has_battery =
            self.present != Some(false) || self.numbers[Field::Voltage as usize] > 0.0;
        for field in FIELDS {
            let value = &mut self.numbers[field as usize];
            let is_of_battery = field as usize >= Field::Power as usize;
            if is_of_battery && !has_battery {
                *value = f64::NAN;
            } else if !value.is_nan() && !(*value as f32).is_finite() {
                refused(field, Unusable::NotFinite);
                *value = f64::NAN;
                // The speed is not known without its part across.
                match field {
                    Field::Vy => self.set(Field::V, f64::NAN),
                    Field::VyMeasured => self.set(Field::VMeasured, f64::NAN),
                    _ => {}
                }
            }
        }
        let of = |field: Field| self.numbers[field as usize];
        let speed = |along: f64, across: f64| match across {
            0.0 => along,
            across if across.is_nan() => along,
            across => along.hypot(across),
        };
        let soc = self.soc(of(Field::Soc), &mut refused);
        let is_reserved = has_battery && self.written_a == UNMEASURED_A;
        if is_reserved {
            refused(Field::Current, Unusable::Unknown);
        }
        let product = of(Field::Voltage) * of(Field::Current) / self.product_units;
        let product_of =
            self.product_of.filter(|_| of(Field::Power).is_nan() && (product as f32).is_finite());
        Mapped {
            seen: Observation {
                v_mps: speed(of(Field::V), of(Field::Vy)),
                omega_radps: of(Field::Omega),
                v_measured_mps: speed(of(Field::VMeasured), of(Field::VyMeasured)),
                omega_measured_radps: of(Field::OmegaMeasured),
                power_w: if product_of.is_some() { product } else { of(Field::Power) },
                voltage_v: of(Field::Voltage),
                current_a: of(Field::Current),
                soc,
                charging: self.charging.filter(|_| has_battery),
                ..Observation::at(0.0)
            },
            is_product: product_of.is_some(),
            power_of: product_of.unwrap_or(self.power_of),
            is_reserved,
            full: self.full.filter(|_| has_battery),
        }
    }

    /// The charge as a share. Drivers write −1 where they do not measure it, and mavros −1 %.
    fn soc(&self, said: f64, refused: &mut impl FnMut(Field, Unusable)) -> f64 {
        let share = said * self.soc_unit;
        // In 32 bits, too.
        if [-1.0, -0.01].contains(&(said as f32)) {
            refused(Field::Soc, Unusable::Unknown);
            return f64::NAN;
        }
        if !share.is_nan() && !SOC.contains(&share) {
            refused(Field::Soc, Unusable::OutOfRange);
        }
        share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mapped(said: Said) -> (Mapped, Vec<(Field, Unusable)>) {
        let mut refused = Vec::new();
        let mapped = said.map(|field, why| refused.push((field, why)));
        (mapped, refused)
    }

    #[test]
    fn a_speed_has_both_parts_and_an_unknown_part_across_is_none() {
        for (along, across, expected) in
            [(0.3, 0.4, 0.5), (-0.3, 0.0, -0.3), (0.3, f64::NAN, 0.3), (f64::NAN, 0.4, f64::NAN)]
        {
            let said = Said::default().with(Field::V, along).with(Field::Vy, across);
            let said = said.with(Field::VMeasured, along).with(Field::VyMeasured, across);
            let seen = mapped(said).0.seen;
            for speed in [seen.v_mps, seen.v_measured_mps] {
                assert_eq!(speed.to_bits(), expected.to_bits(), "{along} {across}");
            }
        }
    }

    #[test]
    fn power_is_what_is_said_or_else_voltage_times_current() {
        let said = Said { product_of: Some(PowerOf::Battery), ..Said::default() };
        let said = said.with(Field::Voltage, 24.0).with(Field::Current, 2.0);
        let (product, _) = mapped(said);
        assert!(product.is_product && product.power_of == PowerOf::Battery);
        assert_eq!(product.seen.power_w, 48.0);
        let (own, _) = mapped(said.with(Field::Power, 5.0));
        assert_eq!((own.seen.power_w, own.is_product, own.power_of), (5.0, false, PowerOf::Load));
        assert!(mapped(Said { product_of: None, ..said }).0.seen.power_w.is_nan());
        let (milli, _) = mapped(Said { product_units: 1e3, ..said });
        assert_eq!(milli.seen.power_w, 0.048);
        let (_, refused) = mapped(said.with(Field::Voltage, f64::INFINITY));
        assert_eq!(refused, [(Field::Voltage, Unusable::NotFinite)]);
        let huge = said.with(Field::Voltage, 1e30).with(Field::Current, 1e30);
        assert!(mapped(huge).0.seen.power_w.is_nan(), "32 bits do not hold it");
    }

    #[test]
    fn a_battery_that_is_absent_says_nothing_and_a_charge_of_minus_one_is_unknown() {
        let said = Said { written_a: -1.0, charging: Some(true), ..Said::default() };
        let said = said.with(Field::Soc, 0.5).with(Field::Voltage, 24.0).with(Field::V, 0.2);
        let (there, refused) = mapped(said);
        assert_eq!((there.seen.soc, there.is_reserved), (0.5, true));
        assert_eq!(refused, [(Field::Current, Unusable::Unknown)]);
        let (unsaid, _) = mapped(Said { present: Some(false), ..said });
        assert_eq!(unsaid.seen.voltage_v, 24.0, "its driver does not fill it in");
        let said = said.with(Field::Voltage, 0.0);
        let (absent, refused) = mapped(Said { present: Some(false), ..said });
        assert!(refused.is_empty() && absent.seen.voltage_v.is_nan() && absent.seen.soc.is_nan());
        assert_eq!((absent.seen.charging, absent.seen.v_mps), (None, 0.2));
        for (soc, unit, expected) in [
            (-1.0, 1.0, Some(Unusable::Unknown)),
            (-1.0, 0.01, Some(Unusable::Unknown)),
            (-0.01, 1.0, Some(Unusable::Unknown)),
            (96.0, 1.0, Some(Unusable::OutOfRange)),
            (96.0, 0.01, None),
        ] {
            let said = Said { soc_unit: unit, ..Said::default() }.with(Field::Soc, soc);
            let (_, refused) = mapped(said);
            let expected: Vec<_> = expected.into_iter().map(|why| (Field::Soc, why)).collect();
            assert_eq!(refused, expected, "{soc} {unit}");
        }
    }
}
