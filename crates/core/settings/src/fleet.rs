//! Settings of a fleet's tick and their check.

use std::ops::RangeInclusive;

use joulebus_wire::fnv1a;
use serde::Serialize;

use crate::bounds::{self, within};
use crate::error::SettingsError;
use crate::platform::{AlarmLimits, Platform};

/// Everything the tick is configured with except the models. [`bounds`] states the range of each
/// number.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FleetSettings {
    /// Maximum number of robots. Samples of further robots are refused and counted.
    pub capacity: u32,
    /// Limits of sample ingest.
    pub intake: Intake,
    /// The intervals around forecasts.
    pub interval: IntervalSettings,
    /// When residuals raise an alarm.
    pub alarms: AlarmSettings,
    /// Robot platforms. Every robot id belongs to at most one.
    pub platforms: Vec<Platform>,
}

/// Limits of sample ingest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Intake {
    /// Samples of one robot that one tick takes. Further ones are dropped as `Backlog`.
    pub max_samples_per_tick: u16,
    /// A stamp further than this after the robot's last one is refused, ns.
    pub max_jump_ns: u64,
    /// Silence after which a robot has left and its slot is freed, ns.
    pub leave_after_ns: u64,
    /// Maximum number of sources tracked by the worker.
    pub max_sources: u16,
}

/// The intervals around forecasts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IntervalSettings {
    /// Nominal coverage: target share of readings inside the interval.
    pub coverage: f32,
    /// Step of an interval end when a reading falls outside it, as a share of its distance.
    pub rate: f32,
}

/// When residuals raise an alarm. Provisional until calibrated on recordings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AlarmSettings {
    /// Weight of the newest residual in the bias.
    pub bias_weight: f32,
    /// Weight of the newest squared residual in the noise ratio.
    pub noise_weight: f32,
    /// Noise ratio at which `NoiseHigh` is raised. Cleared below half.
    pub noise_limit: f32,
    /// Ratio of the model's squared error at which `ModelMismatch` is raised. The reference is
    /// persistence's error, or three times the model's own in training if that is more. The alarm
    /// is cleared below nine tenths of it.
    pub mismatch_limit: f32,
    /// Deviation of a robot's level from its own earlier one at which `LevelHigh` or `LevelLow` is
    /// raised, standard deviations. Cleared below half.
    pub level_limit: f32,
    /// Residuals before any alarm on them is raised.
    pub settle_samples: u32,
    /// Samples in a row that must agree before an alarm is raised.
    pub raise_samples: u16,
    /// Samples in a row that must agree before an alarm is cleared.
    pub clear_samples: u16,
    /// Maximum distance of a feature from the training range, as a share of that range.
    pub training_margin: f32,
}

/// As in a file without these keys.
impl Default for Intake {
    fn default() -> Self {
        Self {
            max_samples_per_tick: 8,
            max_jump_ns: 60_000_000_000,
            leave_after_ns: 30_000_000_000,
            max_sources: 64,
        }
    }
}

/// As in a file without these keys.
impl Default for IntervalSettings {
    fn default() -> Self {
        Self { coverage: 0.9, rate: 0.2 }
    }
}

impl Default for AlarmSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// When a tick is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// Ticks once every robot whose sample is due has reported, or `deadline_ns` after the first.
    OnFrame {
        /// Maximum wait for the remaining robots, ns.
        deadline_ns: u64,
    },
    /// On a grid on the monotonic clock.
    Timer,
}

impl AlarmSettings {
    /// As in a file without these keys.
    pub const DEFAULT: Self = Self {
        bias_weight: 0.005,
        noise_weight: 0.005,
        noise_limit: 15.0,
        mismatch_limit: 2.0,
        level_limit: 8.0,
        settle_samples: 150,
        raise_samples: 20,
        clear_samples: 90,
        training_margin: 0.1,
    };

    /// The limits that a platform may replace.
    pub const fn limits(&self) -> AlarmLimits {
        AlarmLimits {
            noise_limit: self.noise_limit,
            mismatch_limit: self.mismatch_limit,
            level_limit: self.level_limit,
        }
    }

    /// The settings of a platform: with its own limits, if it has any.
    #[must_use]
    pub fn of(&self, platform: &Platform) -> Self {
        let AlarmLimits { noise_limit, mismatch_limit, level_limit } =
            platform.alarms.unwrap_or(self.limits());
        Self { noise_limit, mismatch_limit, level_limit, ..*self }
    }
}

impl FleetSettings {
    /// Checks ranges and consistency.
    ///
    /// # Errors
    /// The first setting that is refused, with its value and its bounds.
    pub fn check(&self) -> Result<(), SettingsError> {
        let Intake { max_samples_per_tick, max_sources, .. } = self.intake;
        let alarms = &self.alarms;
        for (what, found, allowed) in [
            ("capacity", self.capacity, bounds::CAPACITY),
            (
                "number of platforms",
                u32::try_from(self.platforms.len()).unwrap_or(u32::MAX),
                bounds::PLATFORMS,
            ),
            ("max_samples_per_tick", max_samples_per_tick.into(), bounds::MAX_SAMPLES_PER_TICK),
            ("max_sources", max_sources.into(), bounds::MAX_SOURCES),
            ("settle_samples", alarms.settle_samples, bounds::SETTLE_SAMPLES),
            ("raise_samples", alarms.raise_samples.into(), bounds::ALARM_SAMPLES),
            ("clear_samples", alarms.clear_samples.into(), bounds::ALARM_SAMPLES),
        ] {
            within(what, found, &allowed)?;
        }
        for (what, found, allowed) in [
            ("interval coverage", self.interval.coverage, bounds::COVERAGE),
            ("interval rate", self.interval.rate, bounds::INTERVAL_RATE),
            ("bias_weight", alarms.bias_weight, bounds::ALARM_WEIGHT),
            ("noise_weight", alarms.noise_weight, bounds::ALARM_WEIGHT),
            ("noise_limit", alarms.noise_limit, bounds::NOISE_LIMIT),
            ("mismatch_limit", alarms.mismatch_limit, bounds::MISMATCH_LIMIT),
            ("level_limit", alarms.level_limit, bounds::LEVEL_LIMIT),
            ("training_margin", alarms.training_margin, bounds::TRAINING_MARGIN),
        ] {
            within(what, f64::from(found), &allowed)?;
        }
        self.platforms
            .iter()
            .try_for_each(|platform| platform.check(self.intake.leave_after_ns))?;
        self.check_robots_apart()
    }

    /// FNV-1a hash over every value, bit for bit. It differs if the settings differ, and is the
    /// same on every machine.
    pub fn fingerprint(&self) -> u64 {
        // Serialisation into a growing vector of known lengths cannot fail.
        fnv1a(postcard::to_allocvec(self).unwrap_or_default())
    }

    /// True if a platform has a battery.
    pub fn has_batteries(&self) -> bool {
        self.platforms.iter().any(|platform| platform.battery.is_some())
    }

    fn check_robots_apart(&self) -> Result<(), SettingsError> {
        let mut ranges: Vec<(&RangeInclusive<u32>, &str)> = self
            .platforms
            .iter()
            .flat_map(|platform| {
                platform.robots.iter().map(|range| (range, platform.name.as_str()))
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn settings() -> FleetSettings {
        FleetSettings {
            capacity: 10,
            intake: Intake { max_sources: 4, ..Intake::default() },
            interval: IntervalSettings::default(),
            alarms: AlarmSettings::default(),
            platforms: ["one", "two"].map(platform).into(),
        }
    }

    fn platform(name: &str) -> Platform {
        Platform {
            name: name.to_owned(),
            robots: if name == "one" { vec![0..=4, 9..=9] } else { vec![5..=8] },
            period_ns: 33_333_333,
            stale_after_ns: 500_000_000,
            hold_max_ns: 500_000_000,
            stuck_after_ns: 10_000_000_000,
            power_min_w: 0.0,
            power_max_w: 20.0,
            v_max_mps: 0.2,
            omega_max_radps: 3.6,
            power_resolution_w: 0.01,
            battery: Some(crate::Battery {
                initial_soc: 0.9,
                initial_soc_lo: 0.8,
                ..crate::Battery::new(36_000.0, 0.1)
            }),
            alarms: None,
            online: true,
            energy_online: true,
        }
    }

    #[test]
    fn refusals_name_the_setting_its_value_and_both_bounds() {
        assert_eq!(settings().check(), Ok(()));
        type Change = fn(&mut FleetSettings);
        let cases: &[(Change, &str)] = &[
            (|s| s.capacity = 0, "capacity is 0, allowed is 1 to 1000000"),
            (|s| s.intake.max_sources = 1025, "max_sources is 1025, allowed is 1 to 1024"),
            (
                |s| s.interval.coverage = f32::NAN,
                "interval coverage is NaN, allowed is 0.5 to 0.99",
            ),
            (|s| s.alarms.clear_samples = 0, "clear_samples is 0, allowed is 1 to 10000"),
            (
                |s| s.platforms[1].power_min_w = 30.0,
                "power_min_w beside power_max_w of platform two is 30, allowed is -1000000 to 20",
            ),
            (
                |s| s.intake.leave_after_ns = 400_000_000,
                "leave_after_ms beside stale_after of platform one is 400, allowed is at least 500",
            ),
            (
                |s| s.platforms[0].period_ns = 0,
                "period_ms of platform one is 0, allowed is 0.1 to 60000",
            ),
            (
                |s| s.platforms[0].battery.as_mut().unwrap().initial_soc_lo = 1.0,
                "battery initial_soc_lo beside initial_soc of platform one is 1, allowed is 0 to 0.9",
            ),
            (
                |s| {
                    s.platforms[0].alarms =
                        Some(AlarmLimits { noise_limit: f32::NAN, ..s.alarms.limits() });
                },
                "alarms noise_limit of platform one is NaN, allowed is 1.5 to 100",
            ),
            (
                |s| s.platforms[1].robots.push(9..=9),
                "robot 9 belongs to platform one and to platform two: take it out of one of them",
            ),
        ];
        for (change, expected) in cases {
            let mut changed = settings();
            change(&mut changed);
            assert_eq!(changed.check().unwrap_err().to_string(), *expected);
        }
    }

    #[test]
    fn the_fingerprint_changes_with_every_value() {
        let fingerprint = settings().fingerprint();
        assert_eq!(settings().fingerprint(), fingerprint);
        let mut changed = settings();
        changed.platforms[1].online = false;
        assert_ne!(changed.fingerprint(), fingerprint);
        let mut changed = settings();
        changed.platforms[1].energy_online = false;
        assert_ne!(changed.fingerprint(), fingerprint);
        let mut limited = settings();
        limited.platforms[1].alarms = Some(limited.alarms.limits());
        assert_ne!(limited.fingerprint(), fingerprint);
    }
}
