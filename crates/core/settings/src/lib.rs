//! Configuration of the tick as plain values with bounds: limits, platforms, thresholds and the
//! tick policy. No file, no clock. Of samples it knows which values the limits admit.
//!
//! [`FleetSettings::check`] refuses values that are out of range or contradictory.
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
