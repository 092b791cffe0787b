//! What the tick is told before it starts: limits, platforms, thresholds.

use std::ops::RangeInclusive;

use joulebus_wire::fnv1a;
use serde::Serialize;

/// Everything the tick needs to know but the models.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FleetSettings {
    /// Robots that there is room for; the ones past it are refused and named. 1 to 1,000,000.
    pub capacity: u32,
    /// How samples are taken in.
    pub intake: Intake,
    /// The intervals around forecasts.
    pub interval: IntervalSettings,
    /// When residuals raise an alarm.
    pub alarms: AlarmSettings,
    /// The kinds of robots; every robot id belongs to at most one.
    pub platforms: Vec<Platform>,
}

/// How samples are taken in.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Intake {
    /// Samples of one robot that one tick takes; the rest is dropped as `Backlog`. 1 to 1024.
    pub max_samples_per_tick: u16,
    /// A stamp further than this after the robot's last one is refused, ns.
    pub max_jump_ns: u64,
    /// A robot silent for longer than this has left: its slot is free for another, ns.
    pub leave_after_ns: u64,
    /// Sources that the worker keeps account of. 1 to 4096.
    pub max_sources: u16,
}

/// The intervals around forecasts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IntervalSettings {
    /// Share of readings that are to fall inside. 0.5 to 0.99.
    pub coverage: f32,
    /// How far an end moves when a reading falls outside it, as a share of its distance. 0.001 to 0.5.
    pub rate: f32,
}

/// When residuals raise an alarm. Provisional until calibrated on recordings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AlarmSettings {
    /// Weight of the newest residual in the bias. 0.0001 to 0.5.
    pub bias_weight: f32,
    /// Shift that the cumulative sums ignore, standard deviations. 0 to 5.
    pub cusum_slack: f32,
    /// Cumulative sum at which a bias alarm is raised, standard deviations; cleared below half. 1 to 1000.
    pub cusum_limit: f32,
    /// Weight of the newest squared residual in the noise ratio. 0.0001 to 0.5.
    pub noise_weight: f32,
    /// Noise ratio at which `NoiseHigh` is raised; cleared below half. 1.5 to 100.
    pub noise_limit: f32,
    /// Squared error over that of persistence at which `ModelMismatch` is raised; cleared below
    /// nine tenths of it. 1 to 100.
    pub mismatch_limit: f32,
    /// Residuals before any alarm on them is raised. 1 to 1,000,000.
    pub settle_samples: u32,
    /// Samples in a row that must agree before an alarm is raised. 1 to 10,000.
    pub raise_samples: u16,
    /// Samples in a row that must agree before an alarm is cleared. 1 to 10,000.
    pub clear_samples: u16,
    /// How far outside the training range a feature may lie, as a share of that range. 0 to 10.
    pub training_margin: f32,
}

/// A kind of robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Platform {
    /// Its name, for messages.
    pub name: String,
    /// The robots that are of this kind.
    pub robots: Vec<RangeInclusive<u32>>,
    /// Time between two samples, ns.
    pub period_ns: u64,
    /// Silence after which a robot is `Invalid(Stale)`, ns. Also the longest gap that the model
    /// bridges open loop; a longer one empties the lag window.
    pub stale_after_ns: u64,
    /// Age of a measurement past which `HeldTooLong` is raised, ns.
    pub hold_max_ns: u64,
    /// Time over which new measurements may all be equal before `StuckSensor` is raised, ns.
    pub stuck_after_ns: u64,
    /// Least power that can be true, W. Negative where the robot regenerates.
    pub power_min_w: f32,
    /// Greatest power that can be true, W.
    pub power_max_w: f32,
    /// Greatest |v| that can be commanded, m/s.
    pub v_max_mps: f32,
    /// Greatest |ω| that can be commanded, rad/s.
    pub omega_max_radps: f32,
    /// Smallest step of the power monitor, W: the floor of every residual scale.
    pub power_resolution_w: f32,
    /// The battery, where it is known.
    pub battery: Option<Battery>,
    /// What each robot's forecast learns from its own readings.
    pub online: Online,
}

/// What each robot's forecast learns from its own readings; nothing unless asked. Needs a network: a
/// platform that repeats the last reading has nothing to learn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Online {
    /// Persistence, the model's linear baseline and its network are weighed against each other.
    pub mixture: bool,
    /// A level and a gain on the network's forecast are learned.
    pub adapt: bool,
}

/// A battery.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Battery {
    /// Energy from full to empty, J.
    pub capacity_j: f64,
    /// Share of the capacity that is kept in reserve. 0 to 1.
    pub reserve: f64,
    /// State of charge when the ledger starts, best estimate. 0 to 1.
    pub initial_soc: f64,
    /// The same, on the safe side. 0 to `initial_soc`.
    pub initial_soc_lo: f64,
}

/// When a tick is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// As soon as every robot whose sample is due has reported, or `deadline_ns` after the first.
    OnFrame {
        /// How long to wait for the others, ns.
        deadline_ns: u64,
    },
    /// On a grid on the monotonic clock.
    Timer,
}

/// Why settings were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A number lies outside what is allowed.
    #[error("{what} is {found}, allowed is {allowed}")]
    OutOfRange {
        /// Which setting.
        what: String,
        /// What it is.
        found: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// There is not one model for each platform.
    #[error("{platforms} platforms but {models} models: each platform needs exactly one")]
    Models {
        /// Platforms in the settings.
        platforms: usize,
        /// Models given.
        models: usize,
    },
    /// A robot id belongs to two platforms.
    #[error(
        "robot {robot} belongs to platform {first} and to platform {second}: take it out of one of them"
    )]
    SharedRobot {
        /// The robot.
        robot: u32,
        /// The platform that names it first.
        first: String,
        /// The platform that names it again.
        second: String,
    },
}

impl FleetSettings {
    /// Refuses numbers that contradict each other or lie outside their ranges.
    ///
    /// # Errors
    /// The first setting that is refused, with what it is and what it may be.
    pub fn check(&self) -> Result<(), SettingsError> {
        let AlarmSettings {
            cusum_limit,
            noise_limit,
            mismatch_limit,
            ..
        } = self.alarms;
        within(
            "capacity",
            f64::from(self.capacity),
            1.0,
            1e6,
            "1 to 1,000,000",
        )?;
        let intake = &self.intake;
        within(
            "max_samples_per_tick",
            intake.max_samples_per_tick.into(),
            1.0,
            1024.0,
            "1 to 1024",
        )?;
        within(
            "max_sources",
            intake.max_sources.into(),
            1.0,
            4096.0,
            "1 to 4096",
        )?;
        within(
            "interval coverage",
            self.interval.coverage.into(),
            0.5,
            0.99,
            "0.5 to 0.99",
        )?;
        within(
            "interval rate",
            self.interval.rate.into(),
            0.001,
            0.5,
            "0.001 to 0.5",
        )?;
        within(
            "bias_weight",
            self.alarms.bias_weight.into(),
            1e-4,
            0.5,
            "0.0001 to 0.5",
        )?;
        within(
            "noise_weight",
            self.alarms.noise_weight.into(),
            1e-4,
            0.5,
            "0.0001 to 0.5",
        )?;
        within(
            "cusum_slack",
            self.alarms.cusum_slack.into(),
            0.0,
            5.0,
            "0 to 5",
        )?;
        within("cusum_limit", cusum_limit.into(), 1.0, 1000.0, "1 to 1000")?;
        within("noise_limit", noise_limit.into(), 1.5, 100.0, "1.5 to 100")?;
        within(
            "mismatch_limit",
            mismatch_limit.into(),
            1.0,
            100.0,
            "1 to 100",
        )?;
        within(
            "raise_samples",
            self.alarms.raise_samples.into(),
            1.0,
            1e4,
            "1 to 10,000",
        )?;
        within(
            "clear_samples",
            self.alarms.clear_samples.into(),
            1.0,
            1e4,
            "1 to 10,000",
        )?;
        within(
            "training_margin",
            self.alarms.training_margin.into(),
            0.0,
            10.0,
            "0 to 10",
        )?;
        self.platforms
            .iter()
            .try_for_each(|platform| platform.check(intake))?;
        self.check_robots_apart()
    }

    /// A number that differs where the settings do, the same on every machine: FNV-1a over every
    /// value, bit for bit.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        // Never an error: a vector grows, and every length is known.
        let bytes = postcard::to_allocvec(self).unwrap_or_default();
        fnv1a(bytes)
    }

    fn check_robots_apart(&self) -> Result<(), SettingsError> {
        let mut ranges: Vec<(&RangeInclusive<u32>, &str)> = self
            .platforms
            .iter()
            .flat_map(|platform| {
                platform
                    .robots
                    .iter()
                    .map(|range| (range, platform.name.as_str()))
            })
            .collect();
        ranges.sort_by_key(|(range, _)| *range.start());
        for pair in ranges.windows(2) {
            let [(before, first), (after, second)] = pair else {
                continue;
            };
            if after.start() <= before.end() {
                return Err(SettingsError::SharedRobot {
                    robot: *after.start(),
                    first: (*first).to_owned(),
                    second: (*second).to_owned(),
                });
            }
        }
        Ok(())
    }
}

impl Platform {
    fn check(&self, intake: &Intake) -> Result<(), SettingsError> {
        let name = |what: &str| format!("{what} of platform {}", self.name);
        let ms = |ns: u64| ns as f64 / 1e6;
        within(
            &name("period_ms"),
            ms(self.period_ns),
            0.1,
            60_000.0,
            "0.1 to 60,000 ms",
        )?;
        let periods = self.stale_after_ns as f64 / self.period_ns as f64;
        within(
            &name("stale_after, in sample periods,"),
            periods,
            2.0,
            1000.0,
            "2 to 1000 sample periods",
        )?;
        let leave = ms(intake.leave_after_ns);
        within(
            &name("leave_after_ms beside stale_after"),
            leave,
            ms(self.stale_after_ns),
            f64::MAX,
            "at least stale_after",
        )?;
        within(
            &name("power_min_w"),
            self.power_min_w.into(),
            -1e6,
            self.power_max_w.into(),
            "−1,000,000 to power_max_w",
        )?;
        within(
            &name("power_max_w"),
            self.power_max_w.into(),
            0.0,
            1e6,
            "0 to 1,000,000",
        )?;
        within(
            &name("v_max_mps"),
            self.v_max_mps.into(),
            0.0,
            1000.0,
            "0 to 1000",
        )?;
        within(
            &name("omega_max_radps"),
            self.omega_max_radps.into(),
            0.0,
            1000.0,
            "0 to 1000",
        )?;
        within(
            &name("power_resolution_w"),
            self.power_resolution_w.into(),
            1e-9,
            1e6,
            "above 0",
        )?;
        let Some(battery) = &self.battery else {
            return Ok(());
        };
        within(
            &name("battery capacity_j"),
            battery.capacity_j,
            1.0,
            1e12,
            "1 to 1e12",
        )?;
        within(
            &name("battery reserve"),
            battery.reserve,
            0.0,
            1.0,
            "0 to 1",
        )?;
        within(
            &name("battery initial_soc"),
            battery.initial_soc,
            0.0,
            1.0,
            "0 to 1",
        )?;
        within(
            &name("battery initial_soc_lo"),
            battery.initial_soc_lo,
            0.0,
            battery.initial_soc,
            "0 to initial_soc",
        )
    }
}

/// Written so that NaN is refused.
fn within(
    what: &str,
    found: f64,
    lo: f64,
    hi: f64,
    allowed: &'static str,
) -> Result<(), SettingsError> {
    if !(lo <= found && found <= hi) {
        return Err(SettingsError::OutOfRange {
            what: what.to_owned(),
            found,
            allowed,
        });
    }
    Ok(())
}
