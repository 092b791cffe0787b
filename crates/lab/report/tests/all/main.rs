//! The tests of reports and their figures.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

#[path = "../../../eval/tests/all/live.rs"]
mod live;
mod report;
mod usage;
