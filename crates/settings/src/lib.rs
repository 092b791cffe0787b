//! What the tick is told before it starts, as plain values with their bounds: limits, platforms,
//! thresholds and when a tick is due. No file, no clock, no computation on samples.
//!
//! [`FleetSettings::check`] refuses what is out of range or contradictory.
#![forbid(unsafe_code)]

mod fleet;

pub use fleet::{
    AlarmSettings, Battery, FleetSettings, Intake, IntervalSettings, Online, Platform, Policy,
    SettingsError,
};
