#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod admission;
pub mod bounds;
mod domain;
mod error;
mod fleet;
mod limits;
mod platform;
mod scheduling;

pub use admission::RefusedSample;
pub use domain::{
    Domain, DomainError, FLEET_MARKER, RAISES_FILE, REFUSALS_FILE, SHM_DIR, STANDBY_FILES,
};
pub use error::SettingsError;
pub use fleet::{AlarmSettings, FleetSettings, Intake, IntervalSettings, Policy};
pub use limits::{ACTIVE_QUERIES, Limits, LimitsError, Shape};
pub use platform::{
    AlarmLimits, Battery, CHARGE_UNKNOWN, ChargeReading, NO_BATTERY, OpenCircuit, Platform,
};
pub use scheduling::Scheduling;
