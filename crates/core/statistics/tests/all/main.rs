//! The tests of statistics.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod bootstrap;
mod metrics;
mod order;
