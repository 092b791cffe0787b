#![doc = include_str!("../README.md")]
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
