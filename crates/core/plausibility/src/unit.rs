//! Whether magnitudes fit the units, by all values of a robot.
//!
//! Wheeled robots have batteries of 1 to 900 V and draw 5 mA to 300 A and 0.02 W to 20 kW, so that
//! a factor of a thousand is seen. Power beside voltage and current is compared with their product.

use std::f64::consts::PI;

use crate::column::Column;
use crate::finding::{Finding, Kind, Remedy, Severity};
use crate::quantity::{Quantity, number};
use crate::sizes::Sizes;

/// Changes between two units, as a share of the values.
const MAX_SWITCHES: u64 = 100;
/// Values in each of two units.
const MIN_SWITCHED: u64 = 20;
/// Usual sizes of wheeled robots in SI units.
const VOLTAGE_V: (f64, f64) = (0.5, 1_000.0);
const CURRENT_A: (f64, f64) = (0.005, 300.0);
const POWER_W: (f64, f64) = (0.01, 20_000.0);
/// Least power of a robot that moves at a hand's speed, W.
const DRIVING_W: f64 = 0.1;
/// Largest usual speeds, m/s and rad/s: larger ones are in mm/s, cm/s or degrees.
const SPEED_MPS: f64 = 10.0;
const TURN_RADPS: f64 = 12.0;
/// The largest share of charge that a full battery reports.
const FULL: f64 = 1.05;
/// Factor between two units of a quantity.
const THOUSAND: f64 = 1_000.0;

/// Sizes that are judged together.
pub(crate) struct Magnitudes<'a> {
    pub(crate) columns: &'a [Column; 6],
    /// |power| over |voltage · current|.
    pub(crate) ratios: &'a Sizes,
    /// Power over current where no voltage is known, V.
    pub(crate) implied: &'a Sizes,
    /// Power while the robot moves at 0.1 m/s or more.
    pub(crate) driving: &'a Sizes,
    /// Quantities whose unit the source does not state.
    pub(crate) unstated: &'a [bool; 6],
    /// Values of a quantity before their size counts.
    pub(crate) enough: u64,
}

impl Magnitudes<'_> {
    fn usual(&self, quantity: Quantity) -> Option<f64> {
        let sizes = &self.columns[quantity as usize].sizes;
        sizes.usual().filter(|_| sizes.count() >= self.enough)
    }

    fn finding(
        &self,
        quantity: Quantity,
        found: String,
        allowed: String,
        unit: &'static str,
    ) -> Finding {
        Finding {
            kind: Kind::Unit,
            quantity: Some(quantity),
            severity: Severity::Error,
            readings: self.columns[quantity as usize].count,
            found,
            allowed,
            remedy: Remedy::State(unit),
        }
    }

    pub(crate) fn judge(&self) -> Vec<Finding> {
        let mut found = self.unstated();
        if found.is_empty() {
            found.extend(self.sizes());
            found.extend(self.product());
            found.extend(self.implied());
        }
        found.extend(self.switches());
        found.extend(self.speed(Quantity::V, SPEED_MPS, &[("cmps", 1e-2), ("mmps", 1e-3)]));
        found.extend(self.speed(Quantity::Omega, TURN_RADPS, &[("degps", PI / 180.0)]));
        found.extend(self.share());
        found
    }

    /// Columns without a unit: read as they are, or a thousandfold.
    fn unstated(&self) -> Vec<Finding> {
        let is_unstated =
            |quantity: Quantity| self.unstated[quantity as usize] && self.usual(quantity).is_some();
        let asked = [Quantity::Voltage, Quantity::Current].map(is_unstated);
        if asked == [false, false] {
            return Vec::new();
        }
        let scales = |asked: bool| {
            if asked { &[1.0, THOUSAND][..] } else { &[1.0][..] }
        };
        let mut fitting = Vec::new();
        for voltage in scales(asked[0]) {
            for current in scales(asked[1]) {
                // One file has one convention.
                if (asked != [true, true] || voltage == current) && self.fits(*voltage, *current) {
                    fitting.push([*voltage, *current]);
                }
            }
        }
        if fitting == [[1.0, 1.0]] {
            return Vec::new();
        }
        let both = fitting.contains(&[1.0, 1.0]);
        let mut found = Vec::new();
        for (at, quantity, units) in
            [(0, Quantity::Voltage, ("mV", "V")), (1, Quantity::Current, ("mA", "A"))]
        {
            let Some(usual) = self.usual(quantity).filter(|_| asked[at]) else {
                continue;
            };
            if !fitting.is_empty() && fitting.iter().all(|scale| scale[at] == 1.0) {
                continue;
            }
            let (as_milli, as_whole) = (quantity.shown(usual), quantity.shown(usual * THOUSAND));
            let what = match both {
                true => "could be either",
                false => "no robot has the former",
            };
            let reading = format!(
                "{quantity} has no unit: read in {milli} it is usually {as_milli}, in {whole} {as_whole}, {what}",
                quantity = quantity.name(),
                milli = units.0,
                whole = units.1
            );
            let allowed = "a column with its unit in the name, or a mapping that states it";
            found.push(self.finding(quantity, reading, allowed.to_owned(), units.1));
        }
        found
    }

    /// Whether a robot can have voltage and current with these scales.
    fn fits(&self, voltage: f64, current: f64) -> bool {
        let within = |value: Option<f64>, (least, greatest): (f64, f64)| {
            value.is_none_or(|value| (least..=greatest).contains(&value))
        };
        let voltage_v = self.usual(Quantity::Voltage).map(|usual| usual * voltage);
        let current_a = self.usual(Quantity::Current).map(|usual| usual * current);
        if !within(voltage_v, VOLTAGE_V) || !within(current_a, CURRENT_A) {
            return false;
        }
        let power_w = self.usual(Quantity::Power);
        match (power_w, self.ratios.usual(), current_a) {
            // Power of its own beside both: it decides.
            (Some(_), Some(ratio), _) if !is_product(ratio) => {
                ((ratio / (voltage * current)).log10() / 3.0).round() == 0.0
            }
            (Some(power_w), Some(_), _) => within(Some(power_w * voltage * current), POWER_W),
            // Beside one of them, it implies the other.
            (Some(power_w), None, Some(current_a)) => within(Some(power_w / current_a), VOLTAGE_V),
            _ => true,
        }
    }

    /// Quantities whose usual size no robot has.
    fn sizes(&self) -> Vec<Finding> {
        let mut found = Vec::new();
        for (quantity, (least, greatest), smaller) in [
            (Quantity::Voltage, VOLTAGE_V, "mV"),
            (Quantity::Current, CURRENT_A, "mA"),
            (Quantity::Power, POWER_W, "mW"),
        ] {
            let Some(usual) = self.usual(quantity) else {
                continue;
            };
            if (least..=greatest).contains(&usual) {
                continue;
            }
            let other = match usual < least {
                true => usual * THOUSAND,
                false => usual / THOUSAND,
            };
            let what = format!(
                "{} is usually {}. A thousandth or a thousandfold of it, {}, would fit a robot",
                quantity.name(),
                quantity.shown(usual),
                quantity.shown(other)
            );
            let allowed =
                format!("usual are {} to {}", quantity.shown(least), quantity.shown(greatest));
            let unit = if usual < least { quantity.unit() } else { smaller };
            found.push(self.finding(quantity, what, allowed, unit));
        }
        let driving = self.driving.usual().filter(|_| self.driving.count() >= self.enough);
        if found.is_empty()
            && let Some(driving_w) = driving.filter(|driving_w| *driving_w < DRIVING_W)
        {
            let what = format!(
                "power is usually {} while the robot drives. In a thousandfold unit it would be {}",
                Quantity::Power.shown(driving_w),
                Quantity::Power.shown(driving_w * THOUSAND)
            );
            let allowed =
                format!("a robot that drives takes {} or more", Quantity::Power.shown(DRIVING_W));
            found.push(self.finding(Quantity::Power, what, allowed, "W"));
        }
        found
    }

    /// Power that differs from voltage times current by thousands.
    fn product(&self) -> Option<Finding> {
        let ratio = self.ratios.usual().filter(|_| self.ratios.count() >= self.enough)?;
        let thousands = (ratio.log10() / 3.0).round();
        if thousands == 0.0 || !thousands.is_finite() {
            return None;
        }
        let what = format!("power is {} times voltage times current", number(ratio));
        let allowed = "they agree where all three are in the right unit";
        let unit = if ratio < 1.0 { "W" } else { "mW" };
        Some(self.finding(Quantity::Power, what, allowed.to_owned(), unit))
    }

    /// Power and current without a voltage imply one.
    fn implied(&self) -> Option<Finding> {
        let (least, greatest) = VOLTAGE_V;
        let enough = self.implied.count() >= self.enough && self.ratios.count() == 0;
        let implied_v = self.implied.usual().filter(|_| enough)?;
        if (least..=greatest).contains(&implied_v) {
            return None;
        }
        let shown = Quantity::Voltage.shown(implied_v);
        let what = format!("power and current imply a battery of {shown}");
        let allowed = format!("usual are {least} to {}", Quantity::Voltage.shown(greatest));
        let unit = if implied_v < least { "W" } else { "mW" };
        Some(self.finding(Quantity::Power, what, allowed, unit))
    }

    /// Another unit in a part of the recording.
    fn switches(&self) -> Vec<Finding> {
        let mut found = Vec::new();
        for quantity in [Quantity::Power, Quantity::Voltage, Quantity::Current] {
            let column = &self.columns[quantity as usize];
            let Some([(few, small), (many, large)]) = column.sizes.groups() else {
                continue;
            };
            let is_switch = few.min(many) >= MIN_SWITCHED
                && (0.5..=2.0).contains(&(large / small / THOUSAND))
                && (1..=(column.count / MAX_SWITCHES).max(4)).contains(&column.jumps);
            if is_switch {
                let (small, large) = (quantity.shown(small), quantity.shown(large));
                let name = quantity.name();
                let what = format!(
                    "{name} is about {small} in {few} readings and {large} in {many}: its unit changes"
                );
                let allowed = "one unit for all readings".to_owned();
                found.push(Finding {
                    remedy: Remedy::Split,
                    ..self.finding(quantity, what, allowed, "")
                });
            }
        }
        found
    }

    /// Speeds that no robot has: in the largest unit that makes them usual, and in smaller ones.
    fn speed(
        &self,
        quantity: Quantity,
        most: f64,
        units: &[(&'static str, f64)],
    ) -> Option<Finding> {
        let usual = self.usual(quantity).filter(|usual| *usual > most)?;
        let fitting = units.iter().filter(|(_, factor)| usual * factor <= most);
        let read: Vec<String> = fitting
            .clone()
            .map(|(unit, factor)| format!("{} in {unit}", quantity.shown(usual * factor)))
            .collect();
        let mut what = format!("{} is usually {}", quantity.name(), quantity.shown(usual));
        if !read.is_empty() {
            what += &format!(": {}", read.join(", or "));
        }
        let volts = match quantity {
            Quantity::V => "; or it is a voltage",
            _ => "",
        };
        let allowed = format!("usual is up to {}{volts}", quantity.shown(most));
        let unit = fitting.map(|(unit, _)| *unit).next();
        Some(self.finding(quantity, what, allowed, unit.unwrap_or(units[0].0)))
    }

    /// One unit of the charge for all values.
    fn share(&self) -> Option<Finding> {
        let column = &self.columns[Quantity::Soc as usize];
        let usual = self.usual(Quantity::Soc)?;
        let allowed = "0 to 1, or a percentage that is named so";
        if usual > FULL && column.greatest <= 100.0 * FULL {
            let what = format!(
                "soc is usually {} and up to {}: a percentage, so that 1 is 1 % and not full",
                number(usual),
                number(column.greatest)
            );
            return Some(self.finding(Quantity::Soc, what, allowed.to_owned(), "percent"));
        }
        // A percentage of a share. A battery that is nearly empty looks the same, so it has to
        // vary.
        let is_hundredth = column.varies
            && column.greatest <= FULL / 100.0
            && column.greatest > 0.0
            && self.driving.count() >= self.enough;
        is_hundredth.then(|| {
            let what = format!(
                "soc is at most {}: either the battery is nearly empty, or a share of {} was divided by 100",
                number(column.greatest),
                number(column.greatest * 100.0)
            );
            self.finding(Quantity::Soc, what, allowed.to_owned(), "share")
        })
    }
}

/// Whether power was made of voltage and current.
fn is_product(ratio: f64) -> bool {
    (ratio - 1.0).abs() < 1e-6
}
