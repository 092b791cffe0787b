//! The tests of evaluation: forecasts, alarms, calibration, and analyses of recordings.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod alarms;
mod analysis;
mod calibrate;
mod levels;
mod live;
mod online_learning;
mod plant_statistics;
mod remembered;
mod trial;
