//! The tests of the simulated host, and those that run on it.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod channels;
mod clocks;
mod hosts;
mod saves;
mod seeds;
