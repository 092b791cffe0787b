//! Bounds of each setting: the check of values set in code and the keys of the config file
//! (`joulebus config explain`) share them. Both ends are allowed.
//!
//! A bound that only a config file can violate is defined with its key, in `joulebus-config`.

use std::ops::RangeInclusive;

use crate::error::SettingsError;

/// Robots of a fleet.
pub const CAPACITY: RangeInclusive<u32> = 1..=1_000_000;
/// Platforms of a fleet: kinds of robots, each with settings and a model of its own.
pub const PLATFORMS: RangeInclusive<u32> = 0..=256;
/// Samples of one robot that one tick takes.
pub const MAX_SAMPLES_PER_TICK: RangeInclusive<u32> = 1..=1024;
/// Sources that the worker keeps account of, and that can be connected at once.
pub const MAX_SOURCES: RangeInclusive<u32> = 1..=1024;
/// Frames of each source buffered in shared memory.
pub const BUFFER_FRAMES: RangeInclusive<u32> = 2..=256;
/// Planners and live views that can be connected at once. Recorders have places of their own.
pub const MAX_PLANNERS: RangeInclusive<u32> = 1..=256;
/// Nice value of the thread that answers questions.
pub const NICE: RangeInclusive<u32> = 0..=19;
/// Share of readings inside their intervals.
pub const COVERAGE: RangeInclusive<f64> = 0.5..=0.99;
/// Step of an interval's end, as a share of its distance.
pub const INTERVAL_RATE: RangeInclusive<f64> = 0.001..=0.5;
/// Weight of the newest residual in the bias and in the noise ratio.
pub const ALARM_WEIGHT: RangeInclusive<f64> = 1e-4..=0.5;
/// Noise ratio at which an alarm is raised.
pub const NOISE_LIMIT: RangeInclusive<f64> = 1.5..=100.0;
/// Ratio of the squared error to persistence's at which an alarm is raised.
pub const MISMATCH_LIMIT: RangeInclusive<f64> = 1.0..=100.0;
/// [`crate::AlarmLimits::level_limit`].
pub const LEVEL_LIMIT: RangeInclusive<f64> = 1.0..=100.0;
/// Limits of levels, and the false alarms a robot and hour of each at most, with 95 % confidence: of
/// 200 robot-hours (`cargo test -p joulebus-eval --test all false_alarms_of_levels -- --ignored`).
pub const LEVEL_RATES: [(f32, f64); 4] = [(5.5, 0.55), (6.5, 0.14), (8.0, 0.032), (11.0, 0.015)];
/// Rates of false alarms of levels that these limits prove.
pub const LEVEL_RATE: RangeInclusive<f64> = LEVEL_RATES[3].1..=LEVEL_RATES[0].1;
/// Residuals of a robot before an alarm on them.
pub const SETTLE_SAMPLES: RangeInclusive<u32> = 1..=1_000_000;
/// Samples in a row that raise or clear an alarm.
pub const ALARM_SAMPLES: RangeInclusive<u32> = 1..=10_000;
/// Distance of a feature from its training range, as a share of that range.
pub const TRAINING_MARGIN: RangeInclusive<f64> = 0.0..=10.0;
/// Sample period of a robot, ms. Config keys for rates restrict a live fleet to 1 ms to 10 s.
/// Recordings may be faster or slower.
pub const PERIOD_MS: RangeInclusive<f64> = 0.1..=60_000.0;
/// Silence that ends a robot's forecasts, sample periods.
pub const STALE_AFTER_PERIODS: RangeInclusive<f64> = 2.0..=1000.0;
/// Lower power limit, W. It is also at most the upper limit.
pub const POWER_MIN_W: RangeInclusive<f64> = -1e6..=1e6;
/// Upper power limit, W.
pub const POWER_MAX_W: RangeInclusive<f64> = 0.0..=1e6;
/// Resolution of a power monitor, W.
pub const POWER_RESOLUTION_W: RangeInclusive<f64> = 1e-9..=1e6;
/// Maximum commanded linear velocity, m/s.
pub const V_MAX_MPS: RangeInclusive<f64> = 0.0..=1000.0;
/// Maximum commanded angular velocity, rad/s.
pub const OMEGA_MAX_RADPS: RangeInclusive<f64> = 0.0..=1000.0;
/// Battery capacity, Wh.
pub const BATTERY_CAPACITY_WH: RangeInclusive<f64> = 0.001..=1e6;
/// Reserve and state of charge of a battery, as shares of its capacity.
pub const SHARE: RangeInclusive<f64> = 0.0..=1.0;
/// Standard deviation of counted energy, as a share of it.
pub const COUNTING_SD: RangeInclusive<f64> = 0.0..=0.5;
/// Share of the charged energy that a battery stores.
pub const CHARGE_EFFICIENCY: RangeInclusive<f64> = 0.1..=1.0;
/// Greatest power that a charger stores, W.
pub const CHARGE_POWER_W: RangeInclusive<f64> = 0.001..=1e6;
/// Standard deviation of a measured state of charge.
pub const SOC_SD: RangeInclusive<f64> = 0.001..=0.5;
/// Resolution of a measured state of charge.
pub const SOC_STEP: RangeInclusive<f64> = 0.0..=0.2;
/// Distance between raising and clearing a battery's level, as a share of the capacity.
pub const LEVEL_BAND: RangeInclusive<f64> = 0.0..=0.5;
/// Internal resistance of a battery, Ohm.
pub const RESISTANCE_OHM: RangeInclusive<f64> = 0.0..=1000.0;
/// Open-circuit voltage of a battery, V.
pub const OPEN_CIRCUIT_V: RangeInclusive<f64> = 0.1..=2000.0;

/// The lowest limit of levels that keeps a rate of [`LEVEL_RATE`], alarms a robot and hour. `None` of
/// any other.
pub fn level_limit_for(per_robot_h: f64) -> Option<f32> {
    let mut proven = LEVEL_RATES.iter().filter(|_| LEVEL_RATE.contains(&per_robot_h));
    proven.find(|(_, at_most)| *at_most <= per_robot_h).map(|(limit, _)| *limit)
}

/// Refuses `found` outside `allowed`. NaN is outside.
pub(crate) fn within<T: Copy + PartialOrd + Into<f64>>(
    what: &str,
    found: T,
    allowed: &RangeInclusive<T>,
) -> Result<(), SettingsError> {
    if allowed.contains(&found) {
        return Ok(());
    }
    Err(SettingsError::OutOfRange {
        what: what.to_owned(),
        found: found.into(),
        min: (*allowed.start()).into(),
        max: (*allowed.end()).into(),
    })
}
