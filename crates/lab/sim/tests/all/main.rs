//! The tests of the simulated plant.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod barrier;
mod plant;
