//! Configuration of the tick as plain values with bounds: limits, platforms, thresholds and the
//! policy of the tick.
//!
//! Pure: no file and no clock. `joulebus-config` makes these values from the fleet's TOML file.
//!
//! ```
//! use joulebus_settings::{AlarmSettings, FleetSettings, Intake, IntervalSettings};
//!
//! # let alarms = AlarmSettings {
//! #     bias_weight: 0.005, cusum_slack: 1.0, cusum_limit: 50.0, noise_weight: 0.005,
//! #     noise_limit: 15.0, mismatch_limit: 1.5, level_limit: 11.0, settle_samples: 300,
//! #     raise_samples: 15, clear_samples: 90, training_margin: 0.1,
//! # };
//! let intake = Intake {
//!     max_samples_per_tick: 8,
//!     max_jump_ns: 60_000_000_000,
//!     leave_after_ns: 30_000_000_000,
//!     max_sources: 4,
//! };
//! let interval = IntervalSettings { coverage: 0.9, rate: 0.2 };
//! let settings = FleetSettings { capacity: 100, intake, interval, alarms, platforms: Vec::new() };
//! settings.check()?;
//!
//! let none = FleetSettings { capacity: 0, ..settings };
//! let refused = none.check().unwrap_err().to_string();
//! assert_eq!(refused, "capacity is 0, allowed is 1 to 1000000");
//! # Ok::<(), joulebus_settings::SettingsError>(())
//! ```
//!
//! **Three types to know.** [`FleetSettings`] is everything but the models. A [`Platform`] is a
//! robot platform: its timing, its limits and its [`Battery`]. A [`RefusedSample`] states which
//! value of a sample those limits do not admit: the worker and the publishers use the same code.
//!
//! **Units** are those of the fields' names: `_ns`, `_w`, `_j`, `_mps`, `_radps`. Shares are 0 to
//! 1.
//!
//! **Errors.** [`FleetSettings::check`] refuses values that are out of range or contradictory
//! ([`SettingsError`]). An error names the setting, its value and the bounds. [`bounds`] has them
//! all.
//!
//! **In the book**: [config, every key][1], [limits][2], [one file for all processes][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/config.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/limits.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/crates-interfaces-the-build.md#one-file-for-all-processes-and-one-table-of-its-keys
#![forbid(unsafe_code)]

mod admission;
pub mod bounds;
mod error;
mod fleet;
mod platform;

pub use admission::RefusedSample;
pub use error::SettingsError;
pub use fleet::{AlarmSettings, FleetSettings, Intake, IntervalSettings, Policy};
pub use platform::{
    AlarmLimits, Battery, CHARGE_UNKNOWN, ChargeReading, NO_BATTERY, OpenCircuit, Platform,
};
