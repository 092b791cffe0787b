//! A robot platform: timing, limits and battery.

use std::ops::RangeInclusive;

use serde::Serialize;

use crate::bounds::{self, within};
use crate::error::SettingsError;

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
    /// open loop; a longer gap empties the lag window.
    pub stale_after_ns: u64,
    /// Age of a measurement past which `HeldTooLong` is raised, ns.
    pub hold_max_ns: u64,
    /// Time after which identical new measurements raise `StuckSensor`, ns.
    pub stuck_after_ns: u64,
    /// Lower power limit, W. Negative where the platform regenerates.
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
    /// Whether forecasts combine persistence, the model's autoregression and its network with weights that each
    /// robot's own readings teach; otherwise they are the network's. Without a network nothing is learned.
    pub online: bool,
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
    /// Conservative lower bound of it; at most `initial_soc`.
    pub initial_soc_lo: f64,
}

impl Platform {
    /// Checks ranges and consistency; `leave_after_ns`: silence after which a robot has left.
    pub(crate) fn check(&self, leave_after_ns: u64) -> Result<(), SettingsError> {
        let check = |what: &str, found: f64, allowed: RangeInclusive<f64>| {
            within(
                &format!("{what} of platform {}", self.name),
                found,
                &allowed,
            )
        };
        let ms = |ns: u64| ns as f64 / 1e6;
        let stale_after = self.stale_after_ns as f64 / self.period_ns as f64;
        let (least_w, most_w) = bounds::POWER_MIN_W.into_inner();
        let greatest_w = f64::from(self.power_max_w);
        check("period_ms", ms(self.period_ns), bounds::PERIOD_MS)?;
        check(
            "stale_after, in sample periods,",
            stale_after,
            bounds::STALE_AFTER_PERIODS,
        )?;
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
        check(
            "power_resolution_w",
            self.power_resolution_w.into(),
            bounds::POWER_RESOLUTION_W,
        )?;
        check("v_max_mps", self.v_max_mps.into(), bounds::V_MAX_MPS)?;
        check(
            "omega_max_radps",
            self.omega_max_radps.into(),
            bounds::OMEGA_MAX_RADPS,
        )?;
        let Some(battery) = &self.battery else {
            return Ok(());
        };
        check(
            "battery capacity_wh",
            battery.capacity_j / 3600.0,
            bounds::BATTERY_CAPACITY_WH,
        )?;
        check("battery reserve", battery.reserve, bounds::SHARE)?;
        check("battery initial_soc", battery.initial_soc, bounds::SHARE)?;
        check(
            "battery initial_soc_lo beside initial_soc",
            battery.initial_soc_lo,
            *bounds::SHARE.start()..=battery.initial_soc,
        )
    }
}
