//! Which readings of a battery are a robot's consumption: one rule for files and for messages.
//!
//! On the charger the battery's power is no consumption, and a current that no monitor measures
//! makes none either.

use crate::observation::Observation;
use crate::quantity::UNMEASURED_A;
use crate::sign::{MIN_DRIVE_S, MIN_READINGS, moves};

/// Readings of a current that never changes before it is no measurement.
const MIN_CONSTANT: u64 = 100;
/// Changes of the voltage that a current should follow.
const MIN_CHANGES: u64 = 10;
/// Sizes of other currents among which that of [`UNMEASURED_A`] may be measured, A.
pub(crate) const NEAR_A: std::ops::RangeInclusive<f64> = 0.5..=2.0;
/// Steps in an ampere of a coarse monitor, which measures exactly 1 A now and then.
pub(crate) const COARSE: f64 = 10.0;
/// Share of driving readings that are positive if the sign is right.
const POSITIVE: f64 = 0.9;
/// Power into the battery as a share of that of driving: less may be a monitor's offset.
const CLEAR: f64 = 0.1;
/// Difference of power from voltage times current, as a share and in W, that a reading may have.
pub(crate) const AGREE: (f64, f64) = (0.1, 0.03);

/// What the `power_supply_status` of `sensor_msgs/BatteryState` says of charging.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SupplyStatus {
    /// 0: not known.
    Unknown,
    /// 1.
    Charging,
    /// 2 and 3: discharging, or not charging.
    NotCharging,
    /// 4: on the charger, with a full battery.
    Full,
}

impl SupplyStatus {
    /// The status of a number. `None` if the message does not define it.
    #[must_use]
    pub const fn new(number: u8) -> Option<Self> {
        match number {
            0 => Some(Self::Unknown),
            1 => Some(Self::Charging),
            2 | 3 => Some(Self::NotCharging),
            4 => Some(Self::Full),
            _ => None,
        }
    }

    /// True if it is on the charger, if that is known.
    #[must_use]
    pub const fn charging(self) -> Option<bool> {
        match self {
            Self::Unknown => None,
            Self::Charging | Self::Full => Some(true),
            Self::NotCharging => Some(false),
        }
    }
}

/// True if a text says that a battery charges, if it says anything. `is_status`: numbers are those
/// of `power_supply_status`, otherwise 0 and 1.
#[must_use]
pub fn charging_of_text(text: &str, is_status: bool) -> Option<bool> {
    let text = text.trim().to_lowercase();
    if let Ok(number) = text.parse::<f64>() {
        return match is_status {
            true if (0.0..=4.0).contains(&number) && number.fract() == 0.0 => {
                SupplyStatus::new(number as u8)?.charging()
            }
            true => None,
            false if number == 0.0 || number == 1.0 => Some(number == 1.0),
            false => None,
        };
    }
    let word = text.strip_prefix("power_supply_status_").unwrap_or(&text);
    let letters: String = word.chars().filter(char::is_ascii_alphanumeric).collect();
    match letters.as_str() {
        "true" | "yes" | "on" | "charging" | "full" => Some(true),
        "false" | "no" | "off" | "discharging" | "notcharging" => Some(false),
        _ => None,
    }
}

/// True if a power is that of the battery on its charger, and so no consumption.
///
/// `of_battery`: it is voltage times current of the battery. `product_w` is that product, NaN where
/// it is not known.
#[must_use]
pub fn is_charge(power_w: f64, product_w: f64, of_battery: bool, charging: Option<bool>) -> bool {
    let (share, least_w) = AGREE;
    let away_w = (power_w.abs() - product_w.abs()).abs();
    let agrees = away_w <= least_w.max(share * product_w.abs());
    charging == Some(true) && (of_battery || power_w < 0.0 || (product_w < 0.0 && agrees))
}

/// The readings of a battery's current, which show whether a monitor measures it.
#[derive(Debug, Clone, Copy)]
pub struct CurrentMonitor {
    readings: u64,
    first_a: f64,
    varies: bool,
    voltage_v: f64,
    voltage_changes: u64,
    /// Readings of a robot that moves.
    moving: u64,
    rested: bool,
    /// True if another current was near the reserved one, and if all have few digits.
    has_near: bool,
    is_coarse: bool,
}

impl Default for CurrentMonitor {
    fn default() -> Self {
        Self::new()
    }
}

impl CurrentMonitor {
    /// With nothing seen.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            readings: 0,
            first_a: f64::NAN,
            varies: false,
            voltage_v: f64::NAN,
            voltage_changes: 0,
            moving: 0,
            rested: false,
            has_near: false,
            is_coarse: true,
        }
    }

    /// Takes the voltage, current and motion of the next reading. A reading without a current is
    /// none.
    pub fn take(&mut self, seen: &Observation) {
        let (voltage_v, current_a) = (seen.voltage_v, seen.current_a);
        if !current_a.is_finite() {
            return;
        }
        if self.readings == 0 {
            self.first_a = current_a;
        }
        self.readings += 1;
        self.varies |= current_a != self.first_a;
        self.voltage_changes += u64::from((voltage_v - self.voltage_v).abs() > 0.0);
        if voltage_v.is_finite() {
            self.voltage_v = voltage_v;
        }
        match moves(seen) {
            Some(true) => self.moving += 1,
            Some(false) => self.rested = true,
            None => {}
        }
        self.has_near |= current_a.abs() != UNMEASURED_A.abs() && NEAR_A.contains(&current_a.abs());
        let steps = current_a * COARSE;
        self.is_coarse &= (steps - steps.round()).abs() <= 1e-4;
    }

    /// True if the current never changes while the voltage does. At rest alone it need not.
    ///
    /// It says enough of a recording, of which nothing more will come.
    #[must_use]
    pub const fn is_constant(&self) -> bool {
        let only_rested = self.rested && self.moving < MIN_READINGS;
        self.readings >= MIN_CONSTANT
            && !self.varies
            && self.voltage_changes >= MIN_CHANGES
            && !only_rested
    }

    /// True if the current has not changed yet, so that it may be no measurement: the voltage has
    /// changed, or may do so before long.
    pub(crate) const fn is_undecided(&self) -> bool {
        let waits = self.voltage_changes >= MIN_CHANGES || self.readings < MIN_CONSTANT;
        self.readings > 0 && !self.varies && waits
    }

    /// True if it is certain that nobody measures the current, though more will come: it is the same
    /// however long the robot moves, or always [`UNMEASURED_A`].
    ///
    /// A coarse monitor shows one current while a robot rests, and not every robot reports motion.
    #[must_use]
    pub fn is_unmeasured(&self) -> bool {
        self.is_constant() && (self.moving >= MIN_CONSTANT || self.first_a == UNMEASURED_A)
    }

    /// True if a current of exactly [`UNMEASURED_A`] is a reading of a coarse monitor, which has
    /// others of about that size.
    #[must_use]
    pub const fn measures_one_ampere(&self) -> bool {
        self.has_near && self.is_coarse
    }
}

/// Finds a robot on its charger by the sign of its power, where no message says so: at rest the
/// power is negative for seconds, though it is positive while the robot drives.
#[derive(Debug, Clone, Copy)]
pub struct ChargerWatch {
    driven: u64,
    positive: u64,
    /// Sum of the power of driving, W.
    sum_w: f64,
    run: ChargingRun,
}

/// Successive readings at rest with power into the battery.
#[derive(Debug, Clone, Copy)]
struct ChargingRun {
    readings: u64,
    since_s: f64,
    sum_w: f64,
}

impl ChargingRun {
    const NONE: Self = Self { readings: 0, since_s: 0.0, sum_w: 0.0 };
}

impl Default for ChargerWatch {
    fn default() -> Self {
        Self::new()
    }
}

impl ChargerWatch {
    /// With nothing seen.
    #[must_use]
    pub const fn new() -> Self {
        Self { driven: 0, positive: 0, sum_w: 0.0, run: ChargingRun::NONE }
    }

    /// Takes the next reading, and returns true if it is on the charger.
    pub fn take(&mut self, seen: &Observation) -> bool {
        self.learn(seen);
        self.follow(seen)
    }

    /// Learns the sign of power from driving.
    fn learn(&mut self, seen: &Observation) {
        if moves(seen) == Some(true) && seen.power_w.is_finite() && seen.power_w != 0.0 {
            self.driven += 1;
            self.positive += u64::from(seen.power_w > 0.0);
            self.sum_w += seen.power_w;
        }
    }

    fn follow(&mut self, seen: &Observation) -> bool {
        if seen.power_w.is_nan() {
            return false;
        }
        if !(moves(seen) == Some(false) && seen.power_w < 0.0) {
            self.run = ChargingRun::NONE;
            return false;
        }
        if self.run.readings == 0 {
            self.run.since_s = seen.time_s;
        }
        self.run.readings += 1;
        self.run.sum_w += seen.power_w;
        let is_known =
            self.driven >= MIN_READINGS && self.positive as f64 >= POSITIVE * self.driven as f64;
        let mean_w = self.run.sum_w / self.run.readings as f64;
        let is_clear = mean_w <= -CLEAR * self.sum_w / self.driven.max(1) as f64;
        is_known && is_clear && seen.time_s - self.run.since_s >= MIN_DRIVE_S
    }
}

/// The rows of a recording in which a robot is on its charger, by the sign of its power.
pub fn on_charger(rows: usize, row: impl Fn(usize) -> Observation) -> Vec<usize> {
    let (mut watch, mut found) = (ChargerWatch::new(), Vec::new());
    (0..rows).for_each(|at| watch.learn(&row(at)));
    // The first rows of a run are known when it is long enough.
    let mut begun = 0;
    for at in 0..rows {
        let seen = row(at);
        let is_on = watch.follow(&seen);
        if watch.run.readings <= 1 && seen.power_w.is_finite() {
            begun = at;
        }
        if is_on {
            found.extend(found.last().map_or(begun, |last: &usize| begun.max(last + 1))..=at);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(step: u32, voltage_v: f64, current_a: f64, v_mps: f64) -> Observation {
        let power_w = voltage_v * current_a;
        let time_s = 0.1 * f64::from(step);
        Observation { voltage_v, current_a, power_w, v_mps, ..Observation::at(time_s) }
    }

    #[test]
    fn a_current_that_never_changes_while_the_voltage_does_is_no_measurement() {
        let constant = |current: &dyn Fn(u32) -> f64, volt: &dyn Fn(u32) -> f64, v_mps: f64| {
            let mut monitor = CurrentMonitor::default();
            for step in 0..200 {
                monitor.take(&seen(step, volt(step), current(step), v_mps));
            }
            let is_certain = v_mps > 0.0 || current(0) == UNMEASURED_A;
            assert_eq!(monitor.is_unmeasured(), monitor.is_constant() && is_certain);
            monitor.is_constant()
        };
        let sags = |step: u32| 24.0 - 0.001 * f64::from(step % 7);
        for v_mps in [f64::NAN, 0.3] {
            for current_a in [-1.0, 0.01, 0.0, 2.5] {
                assert!(constant(&|_| current_a, &sags, v_mps), "{current_a} A");
            }
            assert!(!constant(&|step| f64::from(step / 150), &sags, v_mps), "it changes");
            assert!(!constant(&|_| 2.5, &|_| 24.0, v_mps), "a bench supply");
        }
        assert!(!constant(&|_| 0.3, &sags, 0.0), "a coarse monitor at rest");
    }

    #[test]
    fn one_ampere_is_measured_by_a_coarse_monitor_among_others_of_its_size() {
        for (others, expected) in [
            (&[0.9, -1.1, -1.0][..], true),
            (&[-1.0, -1.0, -1.0], false),
            (&[-3.2, -1.0, -4.1], false),
            (&[-0.983, -1.0, -1.121], false),
            (&[f64::NAN, -1.0], false),
        ] {
            let mut monitor = CurrentMonitor::default();
            others.iter().for_each(|current_a| monitor.take(&seen(0, 24.0, *current_a, 0.1)));
            assert_eq!(monitor.measures_one_ampere(), expected, "{others:?}");
        }
    }

    #[test]
    fn a_robot_is_on_its_charger_where_power_is_negative_at_rest_for_seconds() {
        // Docked, driving, docked again; then it brakes for a second.
        let power = |step: u32| match step {
            0..60 | 160..220 => (2.9, 0.0),
            60..160 => (-0.4, 0.3),
            220..240 => (-0.3, 0.2),
            240..250 => (2.0, 0.0),
            _ => (-0.2, 0.0),
        };
        let row = |at: usize| {
            let (charge_a, v_mps) = power(at as u32);
            seen(at as u32, 24.0, -charge_a, v_mps)
        };
        let expected: Vec<usize> = (0..60).chain(160..220).collect();
        assert_eq!(on_charger(300, row), expected);
        let turned = |at: usize| {
            let Observation { power_w, .. } = row(at);
            Observation { power_w: -power_w, ..row(at) }
        };
        assert_eq!(on_charger(300, turned), [], "the sign is wrong, which is a finding");
        let offset = |at: usize| {
            let power_w = if row(at).v_mps == 0.0 { -0.2 } else { 9.6 };
            Observation { power_w, ..row(at) }
        };
        assert_eq!(on_charger(300, offset), [], "a monitor's offset at rest");
    }

    #[test]
    fn the_power_of_a_battery_on_its_charger_is_no_consumption() {
        for (power_w, product_w, of_battery, charging, expected) in [
            (-70.0, -70.0, true, Some(true), true),
            (70.0, 70.0, true, Some(true), true),
            (-70.0, f64::NAN, false, Some(true), true),
            (70.0, -70.0, false, Some(true), true),
            (12.0, -70.0, false, Some(true), false),
            (12.0, f64::NAN, false, Some(true), false),
            (-70.0, -70.0, true, Some(false), false),
            (-70.0, -70.0, true, None, false),
        ] {
            let found = is_charge(power_w, product_w, of_battery, charging);
            assert_eq!(found, expected, "{power_w} {product_w} {of_battery} {charging:?}");
        }
    }

    #[test]
    fn a_text_says_whether_a_battery_charges() {
        for (text, is_status, expected) in [
            ("true", false, Some(true)),
            (" True", true, Some(true)),
            ("1", false, Some(true)),
            ("1.0", true, Some(true)),
            ("0", false, Some(false)),
            ("0", true, None),
            ("2", true, Some(false)),
            ("3", true, Some(false)),
            ("4", true, Some(true)),
            ("9", true, None),
            ("-1", true, None),
            ("4", false, None),
            ("POWER_SUPPLY_STATUS_CHARGING", true, Some(true)),
            ("Not charging", true, Some(false)),
            ("DISCHARGING", false, Some(false)),
            ("Full", false, Some(true)),
            ("unknown", false, None),
            ("", false, None),
        ] {
            assert_eq!(charging_of_text(text, is_status), expected, "{text:?}");
        }
    }
}
