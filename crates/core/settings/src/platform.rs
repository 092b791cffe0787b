//! A robot platform: timing, limits and battery.

use std::ops::RangeInclusive;

use serde::Serialize;

use crate::bounds::{self, within};
use crate::error::SettingsError;

/// Remedy for a platform without a [`Battery`], for messages.
pub const NO_BATTERY: &str =
    "no [battery]: add its capacity_wh and initial_soc_lo to the platform's file";

/// Remedy for a battery that may be full or empty, for messages.
pub const CHARGE_UNKNOWN: &str = "charge unknown: say it with `joulebus battery ROBOT --full`, --charge or --exchanged, or let \
     the source send state_of_charge, or report a full or exchanged battery";

/// A robot platform.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Platform {
    /// Its name, for messages.
    pub name: String,
    /// Ids of its robots.
    pub robots: Vec<RangeInclusive<u32>>,
    /// Sample period, ns.
    pub period_ns: u64,
    /// Silence after which a robot is `Invalid(Stale)`, ns. Also the longest gap that is bridged
    /// open loop. A longer gap empties the lag window.
    pub stale_after_ns: u64,
    /// Age of a measurement past which `HeldTooLong` is raised, ns.
    pub hold_max_ns: u64,
    /// Time after which identical new measurements raise `StuckSensor`, ns.
    pub stuck_after_ns: u64,
    /// Lower power limit, W. Negative if the platform regenerates.
    pub power_min_w: f32,
    /// Upper power limit, W.
    pub power_max_w: f32,
    /// Maximum commanded |v|, m/s.
    pub v_max_mps: f32,
    /// Maximum commanded |ω|, rad/s.
    pub omega_max_radps: f32,
    /// Resolution of the power monitor, W: the lower bound of every residual scale.
    pub power_resolution_w: f32,
    /// The battery, if configured.
    pub battery: Option<Battery>,
    /// Limits of its residual alarms, in place of the fleet's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alarms: Option<AlarmLimits>,
    /// True if forecasts combine persistence, the model's autoregression and its network with
    /// weights learned from each robot's own readings. Otherwise they are the network's. Without a
    /// network nothing is learned.
    pub online: bool,
    /// True if the energy of plans adapts to the errors of each robot's own energy forecasts.
    /// Otherwise it is as trained, from the robot's own level.
    pub energy_online: bool,
}

/// Limits of the residual alarms, as in [`AlarmSettings`](crate::AlarmSettings).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AlarmLimits {
    /// Noise ratio at which `NoiseHigh` is raised.
    pub noise_limit: f32,
    /// Squared error over the expected one at which `ModelMismatch` is raised.
    pub mismatch_limit: f32,
    /// Deviation of the level at which `LevelHigh` or `LevelLow` is raised.
    pub level_limit: f32,
}

/// A battery.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Battery {
    /// Energy from full to empty, J.
    pub capacity_j: f64,
    /// Share of the capacity that is kept in reserve.
    pub reserve: f64,
    /// State of charge when the ledger starts, best estimate.
    pub initial_soc: f64,
    /// Lower bound of it, two standard deviations below. At most `initial_soc`.
    pub initial_soc_lo: f64,
    /// Standard deviation of the energy counted, as a share of it: error of the power monitor and
    /// of the capacity.
    pub counting_sd: f64,
    /// Meaning of readings on the charger.
    pub charge_reading: ChargeReading,
    /// Share of the charged energy that is stored.
    pub charge_efficiency: f64,
    /// Greatest power that is stored while the charge is not metered, W. `None`: any.
    pub charge_power_w: Option<f64>,
    /// State of charge when the charger reports a full battery.
    pub on_full_soc: f64,
    /// Standard deviation of a measured state of charge. It is treated as an error that lasts for
    /// about an hour.
    pub sensor_sd: f64,
    /// Resolution of a measured state of charge.
    pub sensor_step: f64,
    /// State of charge from the open-circuit voltage, for robots that measure no state of charge.
    pub open_circuit: Option<OpenCircuit>,
    /// State of charge below which `BatteryLow` is raised.
    pub low: f64,
    /// State of charge below which `BatteryCritical` is raised. At most `low`.
    pub critical: f64,
    /// A level is cleared this far above the state of charge at which it is raised.
    pub level_band: f64,
    /// Energy that a robot needs to return from anywhere, J, if its samples do not state it.
    /// `None`: `CannotReturn` is raised only for robots whose samples state it.
    pub return_j: Option<f64>,
    /// Energy that docking costs at the end of a way back, J.
    pub docking_j: f64,
}

/// The meaning of a power reading while the robot is on its charger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum ChargeReading {
    /// Power out of the battery: negative while it is charged.
    Battery,
    /// Power into the battery: positive while it is charged.
    Charger,
    /// The robot's consumption. The power that charges the battery is not metered.
    Load,
}

/// Open-circuit voltages of a battery at equal distances of the state of charge, from empty to
/// full.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OpenCircuit {
    voltages_v: [f64; Self::MAX_POINTS],
    points: usize,
    /// Internal resistance, Ohm, which lowers the voltage under load.
    pub resistance_ohm: f64,
    /// Standard deviation of a state of charge that a voltage gives.
    pub sd: f64,
}

impl OpenCircuit {
    /// Maximum number of points of a table.
    pub const MAX_POINTS: usize = 21;
    /// Share of the table's span by which a voltage may be outside. Voltages farther outside give
    /// no state of charge.
    const MARGIN: f64 = 0.1;

    /// A table of 2 to [`OpenCircuit::MAX_POINTS`] rising voltages. `None` for any other.
    #[must_use]
    pub fn new(voltages_v: &[f64], resistance_ohm: f64, sd: f64) -> Option<Self> {
        let rising = voltages_v.windows(2).all(|pair| pair[0] < pair[1]);
        if !rising || !(2..=Self::MAX_POINTS).contains(&voltages_v.len()) {
            return None;
        }
        let mut table = Self {
            voltages_v: [0.0; Self::MAX_POINTS],
            points: voltages_v.len(),
            resistance_ohm,
            sd,
        };
        table.voltages_v[..voltages_v.len()].copy_from_slice(voltages_v);
        Some(table)
    }

    /// The voltages, from empty to full, V.
    pub fn voltages_v(&self) -> &[f64] {
        &self.voltages_v[..self.points]
    }

    /// State of charge at a terminal voltage, V, while a current, A, is drawn. `None` if the
    /// voltage is outside the table.
    #[must_use]
    pub fn soc(&self, voltage_v: f64, current_a: f64) -> Option<f64> {
        let table = self.voltages_v();
        let (empty_v, full_v) = (table[0], table[table.len() - 1]);
        let open_v = voltage_v + current_a * self.resistance_ohm;
        let slack_v = Self::MARGIN * (full_v - empty_v);
        if !(empty_v - slack_v <= open_v && open_v <= full_v + slack_v) {
            return None;
        }
        let open_v = open_v.clamp(empty_v, full_v);
        let above = table.partition_point(|voltage_v| *voltage_v <= open_v);
        let above = above.clamp(1, table.len() - 1);
        let (from_v, to_v) = (table[above - 1], table[above]);
        let part = (open_v - from_v) / (to_v - from_v);
        Some(((above - 1) as f64 + part) / (table.len() - 1) as f64)
    }
}

impl Platform {
    /// True if the robot is of this platform.
    #[must_use]
    pub fn has(&self, robot: u32) -> bool {
        self.robots.iter().any(|range| range.contains(&robot))
    }

    /// Checks ranges and consistency. `leave_after_ns`: silence after which a robot has left.
    pub(crate) fn check(&self, leave_after_ns: u64) -> Result<(), SettingsError> {
        let check = |what: &str, found: f64, allowed: RangeInclusive<f64>| {
            within(&format!("{what} of platform {}", self.name), found, &allowed)
        };
        let ms = |ns: u64| ns as f64 / 1e6;
        let stale_after = self.stale_after_ns as f64 / self.period_ns as f64;
        let (least_w, most_w) = bounds::POWER_MIN_W.into_inner();
        let greatest_w = f64::from(self.power_max_w);
        check("period_ms", ms(self.period_ns), bounds::PERIOD_MS)?;
        check("stale_after, in sample periods,", stale_after, bounds::STALE_AFTER_PERIODS)?;
        check(
            "leave_after_ms beside stale_after",
            ms(leave_after_ns),
            ms(self.stale_after_ns)..=f64::INFINITY,
        )?;
        check("power_max_w", greatest_w, bounds::POWER_MAX_W)?;
        check(
            "power_min_w beside power_max_w",
            self.power_min_w.into(),
            least_w..=most_w.min(greatest_w),
        )?;
        check("power_resolution_w", self.power_resolution_w.into(), bounds::POWER_RESOLUTION_W)?;
        check("v_max_mps", self.v_max_mps.into(), bounds::V_MAX_MPS)?;
        check("omega_max_radps", self.omega_max_radps.into(), bounds::OMEGA_MAX_RADPS)?;
        if let Some(limits) = &self.alarms {
            limits.check(check)?;
        }
        let Some(battery) = &self.battery else {
            return Ok(());
        };
        check("battery capacity_wh", battery.capacity_j / 3600.0, bounds::BATTERY_CAPACITY_WH)?;
        check("battery reserve", battery.reserve, bounds::SHARE)?;
        check("battery initial_soc", battery.initial_soc, bounds::SHARE)?;
        check(
            "battery initial_soc_lo beside initial_soc",
            battery.initial_soc_lo,
            *bounds::SHARE.start()..=battery.initial_soc,
        )?;
        battery.check(check)
    }
}

impl AlarmLimits {
    fn check(
        &self,
        check: impl Fn(&str, f64, RangeInclusive<f64>) -> Result<(), SettingsError>,
    ) -> Result<(), SettingsError> {
        let [noise, mismatch] = [self.noise_limit, self.mismatch_limit];
        check("alarms noise_limit", noise.into(), bounds::NOISE_LIMIT)?;
        check("alarms mismatch_limit", mismatch.into(), bounds::MISMATCH_LIMIT)?;
        let level = self.level_limit.into();
        check("alarms level_limit", level, bounds::LEVEL_LIMIT)
    }
}

impl Battery {
    /// Checks charging, the measured state of charge and the levels.
    fn check(
        &self,
        check: impl Fn(&str, f64, RangeInclusive<f64>) -> Result<(), SettingsError>,
    ) -> Result<(), SettingsError> {
        let least = *bounds::SHARE.start();
        let (charge_w, table) = (self.charge_power_w, self.open_circuit);
        let any_w = *bounds::CHARGE_POWER_W.end();
        check("battery counting_sd", self.counting_sd, bounds::COUNTING_SD)?;
        check("battery charge_efficiency", self.charge_efficiency, bounds::CHARGE_EFFICIENCY)?;
        check("battery charge_power_w", charge_w.unwrap_or(any_w), bounds::CHARGE_POWER_W)?;
        check("battery on_full_soc", self.on_full_soc, bounds::SHARE)?;
        check("battery sensor_sd", self.sensor_sd, bounds::SOC_SD)?;
        check("battery sensor_step", self.sensor_step, bounds::SOC_STEP)?;
        check("battery low", self.low, bounds::SHARE)?;
        check("battery critical beside low", self.critical, least..=self.low)?;
        check("battery level_band", self.level_band, bounds::LEVEL_BAND)?;
        let return_j = self.return_j.unwrap_or(least);
        check("battery return energy beside the capacity", return_j, least..=self.capacity_j)?;
        let docking_j = self.docking_j;
        check("battery docking energy beside the capacity", docking_j, least..=self.capacity_j)?;
        if let Some(table) = &table {
            check("battery open_circuit_sd", table.sd, bounds::SOC_SD)?;
            check("battery resistance_ohm", table.resistance_ohm, bounds::RESISTANCE_OHM)?;
            for voltage_v in table.voltages_v() {
                check("battery open_circuit_v", *voltage_v, bounds::OPEN_CIRCUIT_V)?;
            }
        }
        Ok(())
    }

    /// A battery of `capacity_j` with `reserve`, that is full and charged without being metered,
    /// with the defaults of the config file otherwise.
    #[must_use]
    pub const fn new(capacity_j: f64, reserve: f64) -> Self {
        Self {
            capacity_j,
            reserve,
            initial_soc: 1.0,
            initial_soc_lo: 1.0,
            counting_sd: 0.03,
            charge_reading: ChargeReading::Load,
            charge_efficiency: 0.9,
            charge_power_w: None,
            on_full_soc: 1.0,
            sensor_sd: 0.05,
            sensor_step: 0.01,
            open_circuit: None,
            low: 0.2,
            critical: 0.1,
            level_band: 0.03,
            return_j: None,
            docking_j: 0.0,
        }
    }
}
