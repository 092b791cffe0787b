//! What the tick is told before it starts, as plain values with their bounds: limits, platforms,
//! thresholds and when a tick is due. No file, no clock, no computation on samples.
//!
//! [`FleetSettings::check`] refuses what is out of range or contradictory.
#![forbid(unsafe_code)]

pub mod bounds;
mod error;
mod fleet;
mod platform;

pub use error::SettingsError;
pub use fleet::{AlarmSettings, FleetSettings, Intake, IntervalSettings, Policy};
pub use platform::{Battery, Online, Platform};
