//! The tick, pure: samples in, forecasts, diagnostics and budgets out.
//!
//! No clock, file, thread or shared memory: time comes in as an argument, so that a live run, a
//! replay and a simulation are the same code.
#![forbid(unsafe_code)]

mod settings;

pub use settings::{
    AlarmSettings, Battery, Intake, IntervalSettings, Platform, Policy, Settings, SettingsError,
};
