//! Configuration of the tick as plain values with bounds: limits, platforms, thresholds and the
//! tick policy. No file, no clock, no computation on samples.
//!
//! [`FleetSettings::check`] refuses values that are out of range or contradictory.
#![forbid(unsafe_code)]

pub mod bounds;
mod error;
mod fleet;
mod platform;

pub use error::SettingsError;
pub use fleet::{AlarmSettings, FleetSettings, Intake, IntervalSettings, Policy};
pub use platform::{AlarmLimits, Battery, ChargeReading, NO_BATTERY, OpenCircuit, Platform};
