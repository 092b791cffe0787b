//! The tests of evaluation: forecasts, alarms, and analyses of recordings.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod alarms;
mod analysis;
mod levels;
mod live;
mod online_learning;
mod plant_statistics;
mod trial;
