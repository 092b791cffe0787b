//! Judges whether magnitudes fit the units, by all values of a robot.
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
/// Sizes that most of them have, in the order of [`MEASURED`]: of several readings, these count.
const EVERYDAY: [(f64, f64); 3] = [(0.5, 2_000.0), (2.5, 100.0), (0.03, 50.0)];
const MEASURED: [Quantity; 3] = [Quantity::Power, Quantity::Voltage, Quantity::Current];
/// Least power of a robot that moves at a hand's speed, W.
const DRIVING_W: f64 = 0.1;
/// Largest usual speeds, m/s and rad/s: larger ones are in mm/s, cm/s or degrees.
const SPEED_MPS: f64 = 10.0;
const TURN_RADPS: f64 = 12.0;
/// Resistance of batteries with their wires, Ω.
const RESISTANCE_OHM: (f64, f64) = (5e-4, 8.0);
/// The largest share of charge that a full battery reports.
const FULL: f64 = 1.05;
/// Voltage of vehicles that draw more current than most robots.
const VEHICLE_V: f64 = 24.0;
/// Readings that rise before they are a counter's.
const MIN_COUNTS: u64 = 100;
const THOUSAND: f64 = 1_000.0;
/// Units of a column that states none, in thousands of the one in which it is read.
const UNSTATED: [i8; 3] = [0, 1, -1];

fn scale(thousands: i8) -> f64 {
    THOUSAND.powi(thousands.into())
}

pub(crate) struct Magnitudes<'a> {
    pub(crate) columns: &'a [Column; 6],
    /// |power| over |voltage · current|.
    pub(crate) ratios: &'a Sizes,
    /// Power over current where no voltage is known, V.
    pub(crate) implied: &'a Sizes,
    /// Power while the robot moves at 0.1 m/s or more.
    pub(crate) driving: &'a Sizes,
    pub(crate) driven: u64,
    /// Fall of the voltage for each ampere more, Ω, if it is clear.
    pub(crate) resistance_ohm: Option<f64>,
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
        remedy: Remedy,
        found: String,
        allowed: impl Into<String>,
    ) -> Finding {
        let (of, readings) = ((Kind::Unit, Severity::Error), self.columns[quantity as usize].count);
        Finding::new(of, quantity, readings, remedy, found, allowed)
    }

    pub(crate) fn judge(&self) -> Vec<Finding> {
        let mut found = self.unstated();
        if found.is_empty() {
            found.extend(self.sizes());
        }
        if found.is_empty() {
            found.extend(self.product());
            found.extend(self.implied());
        }
        if found.is_empty() {
            found.extend(self.resistance());
        }
        found.extend(self.switches());
        found.extend(
            [Quantity::Power, Quantity::Current].into_iter().filter_map(|one| self.counter(one)),
        );
        found.extend(self.speed(Quantity::V, SPEED_MPS, &[("cmps", 1e-2), ("mmps", 1e-3)]));
        found.extend(self.speed(Quantity::Omega, TURN_RADPS, &[("degps", PI / 180.0)]));
        found.extend(self.share());
        found
    }

    /// Columns without a unit: each in every unit that it can have.
    fn unstated(&self) -> Vec<Finding> {
        let asked = [Quantity::Voltage, Quantity::Current]
            .map(|quantity| self.unstated[quantity as usize] && self.usual(quantity).is_some());
        let units = |asked: bool, all: &'static [i8]| if asked { all } else { &all[..1] };
        let mut fitting = Vec::new();
        for voltage in units(asked[0], &UNSTATED[..2]) {
            for current in units(asked[1], &UNSTATED) {
                if self.is_reading(asked == [true, true], *voltage, *current) {
                    fitting.push([*voltage, *current]);
                }
            }
        }
        if asked == [false, false] || fitting == [[0, 0]] {
            return Vec::new();
        }
        let mut found = Vec::new();
        for (at, quantity) in [(0, Quantity::Voltage), (1, Quantity::Current)] {
            let Some(usual) = self.usual(quantity).filter(|_| asked[at]) else {
                continue;
            };
            let can_be = |unit: &i8| fitting.iter().any(|pair| pair[at] == *unit);
            let units: Vec<i8> = UNSTATED.into_iter().filter(can_be).collect();
            if units == [0] {
                continue;
            }
            let name =
                |unit: i8| format!("{}{}", ["u", "m", ""][(unit + 1) as usize], quantity.unit());
            let read = match units.len() {
                0 | 1 => &UNSTATED[..2],
                _ => &units,
            };
            let read: Vec<String> = read
                .iter()
                .map(|unit| format!("in {} {}", name(*unit), quantity.shown(usual * scale(*unit))))
                .collect();
            let which = match units.as_slice() {
                [] => "no robot has either".to_owned(),
                [unit] => format!("only {} fits a robot", name(*unit)),
                _ => "it could be either".to_owned(),
            };
            let (quantity_name, read) = (quantity.name(), read.join(", "));
            let what = format!("{quantity_name} has no unit. It is usually {read}: {which}");
            let allowed = "a column has its unit in its name, or a mapping states it";
            let of = Remedy::Scale {
                read: quantity.milli(),
                thousands: [
                    units.first().copied().unwrap_or(1),
                    units.get(1).copied().unwrap_or(0),
                ],
            };
            found.push(self.finding(quantity, of, what, allowed));
        }
        found
    }

    /// True if voltage and current may be in these units, in thousands of those in which they are
    /// read. One file has one convention, and no millionths, unless another is what is usual.
    fn is_reading(&self, both: bool, voltage: i8, current: i8) -> bool {
        let is_usual = |thousands: i8| self.is_everyday(Quantity::Current, scale(thousands));
        let is_whole = self.columns[Quantity::Current as usize].decimals <= 3;
        let voltage_v =
            self.usual(Quantity::Voltage).map_or(f64::NAN, |usual| usual * scale(voltage));
        let is_vehicle = current == 1 && voltage_v >= VEHICLE_V;
        let is_likely = match current {
            // Few monitors count whole amperes.
            _ if both && voltage != current && current >= 0 => {
                (is_usual(current) || is_vehicle) && !(is_whole && current == 1)
            }
            0.. => true,
            _ => is_usual(current) && !is_usual(0),
        };
        is_likely && self.fits(scale(voltage), scale(current))
    }

    /// True if a quantity, in another scale, has a size that most robots have.
    fn is_everyday(&self, quantity: Quantity, scale: f64) -> bool {
        let place = MEASURED.iter().position(|measured| *measured == quantity);
        let range = place.map(|place| EVERYDAY[place]);
        let is_within = |(least, greatest)| {
            let usual = self.usual(quantity).map(|usual| usual * scale);
            usual.is_none_or(|usual| (least..=greatest).contains(&usual))
        };
        range.is_none_or(is_within)
    }

    /// True if a robot can have voltage and current with these scales.
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
        for (quantity, (least, greatest)) in [
            (Quantity::Voltage, VOLTAGE_V),
            (Quantity::Current, CURRENT_A),
            (Quantity::Power, POWER_W),
        ] {
            let Some(usual) = self.usual(quantity) else {
                continue;
            };
            // Power of voltage and current is as wrong as they are.
            let is_made = quantity == Quantity::Power && !found.is_empty() && self.is_product();
            if (least..=greatest).contains(&usual) || is_made {
                continue;
            }
            let others = if usual < least { [1, 2] } else { [-1, -2] };
            let is_robots = |unit: &i8| (least..=greatest).contains(&(usual * scale(*unit)));
            let mut others: Vec<i8> = others.into_iter().filter(is_robots).collect();
            // A millionth only where it is more usual, or the thousandth is none.
            let has_next = others.iter().any(|unit| unit.abs() == 1);
            others.retain(|unit| {
                unit.abs() == 1 || !has_next || self.is_everyday(quantity, scale(*unit))
            });
            let what = format!("{} is usually {}", quantity.name(), quantity.shown(usual));
            let what = what
                + &match others.is_empty() {
                    true => String::new(),
                    false => {
                        format!(". In another unit it would be {}", self.read(quantity, &others))
                    }
                };
            let allowed =
                format!("usual are {} to {}", quantity.shown(least), quantity.shown(greatest));
            found.push(self.scaled(quantity, what, allowed, &others, usual < least));
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
            let wrong = if self.is_product() { Quantity::Current } else { Quantity::Power };
            found.push(self.scaled(wrong, what, allowed, &[1], true));
        }
        found
    }

    fn is_product(&self) -> bool {
        self.ratios.usual().is_some_and(is_product)
    }

    /// A current that lowers the voltage by more, or by less, than that of a battery.
    fn resistance(&self) -> Option<Finding> {
        let (least, greatest) = RESISTANCE_OHM;
        let ohm = self.resistance_ohm.filter(|ohm| !(least..=greatest).contains(ohm))?;
        let unit = if ohm > greatest { 1 } else { -1 };
        // Voltages are usual here.
        let usual = self.usual(Quantity::Current)?;
        if !self.is_everyday(Quantity::Current, scale(unit)) {
            return None;
        }
        let what = format!(
            "the voltage falls by {} V for each ampere more. The current may be {} and not {}",
            number(ohm),
            Quantity::Current.shown(usual * scale(unit)),
            Quantity::Current.shown(usual)
        );
        let allowed = format!("usual are {least} to {greatest} V for each ampere");
        Some(self.scaled(Quantity::Current, what, allowed, &[unit], unit > 0))
    }

    /// Formats the usual value of a quantity in other units, in thousands of the one in which it
    /// was read.
    fn read(&self, quantity: Quantity, units: &[i8]) -> String {
        let usual = self.usual(quantity).unwrap_or(f64::NAN);
        let read: Vec<String> =
            units.iter().map(|unit| quantity.shown(usual * scale(*unit))).collect();
        read.join(" or ")
    }

    /// A quantity that is in another unit, in thousands of the one in which it was read.
    fn scaled(
        &self,
        quantity: Quantity,
        what: String,
        allowed: impl Into<String>,
        units: &[i8],
        is_small: bool,
    ) -> Finding {
        let first = units.first().copied().unwrap_or(if is_small { 1 } else { -1 });
        let remedy = Remedy::Scale {
            read: if is_small { quantity.milli() } else { quantity.unit() },
            thousands: [first, units.get(1).copied().unwrap_or(0)],
        };
        self.finding(quantity, remedy, what, allowed)
    }

    /// Power that differs from voltage times current by thousands.
    fn product(&self) -> Option<Finding> {
        let ratio = self.ratios.usual().filter(|_| self.ratios.count() >= self.enough)?;
        let thousands = (ratio.log10() / 3.0).round();
        if thousands == 0.0 || !thousands.is_finite() {
            return None;
        }
        let thousands = thousands.clamp(-4.0, 4.0) as i8;
        // The one whose other unit makes all three usual. Power, if that is none, or several.
        let changes =
            MEASURED.map(|one| if one == Quantity::Power { -thousands } else { thousands });
        let is_usual_with = |changed: usize| {
            MEASURED.into_iter().enumerate().all(|(at, of)| {
                let change = if at == changed { changes[at] } else { 0 };
                self.is_everyday(of, scale(change))
            })
        };
        let mut fitting = (0..MEASURED.len()).filter(|at| is_usual_with(*at));
        let at = match (fitting.next(), fitting.next()) {
            (Some(only), None) => only,
            _ => 0,
        };
        let (quantity, change) = (MEASURED[at], changes[at]);
        let what = format!(
            "power is {} times voltage times current. They agree if {} is {} and not {}",
            number(ratio),
            quantity.name(),
            self.read(quantity, &[change]),
            self.read(quantity, &[0])
        );
        let allowed = "power is voltage times current where all three have the right unit";
        Some(self.scaled(quantity, what, allowed, &[change], change > 0))
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
        let is_small = implied_v < least;
        Some(self.scaled(
            Quantity::Power,
            what,
            allowed,
            &[if is_small { 1 } else { -1 }],
            is_small,
        ))
    }

    /// Another unit in a part of the recording.
    fn switches(&self) -> Vec<Finding> {
        let mut found = Vec::new();
        for quantity in [Quantity::Power, Quantity::Voltage, Quantity::Current] {
            let column = &self.columns[quantity as usize];
            let Some([(few, small), (many, large)]) = column.sizes.groups() else {
                continue;
            };
            let ratio = large / small / THOUSAND;
            let is_rare = column.jumps <= (column.count / MAX_SWITCHES).max(4);
            // Rows of two units in turn: a robot that sleeps does not use a thousandth so exactly.
            let is_exact = quantity == Quantity::Voltage || (0.8..=1.25).contains(&ratio);
            let is_switch = few.min(many) >= MIN_SWITCHED
                && (0.5..=2.0).contains(&ratio)
                && column.jumps > 0
                && (is_rare || is_exact);
            if is_switch {
                let (small, large) = (quantity.shown(small), quantity.shown(large));
                let name = quantity.name();
                let what = format!(
                    "{name} is about {small} in {few} readings and {large} in {many}: its unit changes"
                );
                let allowed = "a recording has one unit for all readings";
                found.push(self.finding(quantity, Remedy::Split, what, allowed));
            }
        }
        found
    }

    /// An energy or a charge so far in place of a power or a current: it only rises, or begins
    /// again at 0.
    fn counter(&self, quantity: Quantity) -> Option<Finding> {
        let column = &self.columns[quantity as usize];
        let moves = &column.moves;
        let only_rises = moves.falls == moves.resets && MIN_COUNTS * moves.falls <= 2 * moves.rises;
        if !(only_rises && moves.rises >= MIN_COUNTS && 2 * moves.rises >= column.count) {
            return None;
        }
        let name = quantity.name();
        let what = format!(
            "{name} never falls in {} readings, from {} to {}: a counter, and no {name}",
            column.count,
            quantity.shown(column.least),
            quantity.shown(column.greatest)
        );
        let allowed = format!("a {name} rises and falls with what the robot does");
        Some(self.finding(quantity, Remedy::Counter, what, allowed))
    }

    /// Speeds that no robot has: in the largest unit that makes them usual, and in smaller ones.
    fn speed(
        &self,
        quantity: Quantity,
        most: f64,
        units: &[(&'static str, f64)],
    ) -> Option<Finding> {
        // A robot mostly turns a little, so its median can be usual in degrees as well.
        let (share, often) = match quantity {
            Quantity::Omega => (0.9, "often"),
            _ => (0.5, "usually"),
        };
        self.usual(quantity)?;
        let sizes = &self.columns[quantity as usize].sizes;
        let usual = sizes.quantile(share).filter(|usual| *usual > most)?;
        let fitting = units.iter().filter(|(_, factor)| usual * factor <= most);
        let read: Vec<String> = fitting
            .clone()
            .map(|(unit, factor)| format!("{} in {unit}", quantity.shown(usual * factor)))
            .collect();
        let mut what = format!("{} is {often} {}", quantity.name(), quantity.shown(usual));
        if !read.is_empty() {
            what += &format!(": {}", read.join(", or "));
        }
        let volts = match quantity {
            Quantity::V => ", or it is a voltage",
            _ => "",
        };
        let allowed = format!("usual is up to {}{volts}", quantity.shown(most));
        let unit = fitting.map(|(unit, _)| *unit).next().unwrap_or(units[0].0);
        Some(self.finding(quantity, Remedy::State(unit), what, allowed))
    }

    /// One unit of the charge for all values.
    fn share(&self) -> Option<Finding> {
        let column = &self.columns[Quantity::Soc as usize];
        let usual = self.usual(Quantity::Soc)?;
        let allowed = "a charge is 0 to 1, or a percentage that is named so";
        if usual > FULL && column.greatest <= 100.0 * FULL {
            let what = format!(
                "soc is usually {} and up to {}: a percentage, so that 1 is 1 % and not full",
                number(usual),
                number(column.greatest)
            );
            return Some(self.finding(Quantity::Soc, Remedy::State("percent"), what, allowed));
        }
        // A percentage of a share: no battery drives for long with so little.
        let is_hundredth =
            column.greatest <= FULL / 100.0 && column.greatest > 0.0 && self.driven >= self.enough;
        is_hundredth.then(|| {
            let what = format!(
                "soc is at most {}: either the battery is nearly empty, or a share of {} was divided by 100",
                number(column.greatest),
                number(column.greatest * 100.0)
            );
            self.finding(Quantity::Soc, Remedy::State("share"), what, allowed)
        })
    }
}

fn is_product(ratio: f64) -> bool {
    (ratio - 1.0).abs() < 1e-6
}
