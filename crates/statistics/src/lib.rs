//! Statistics that every offline crate shares: sums of errors and quantiles, bootstrap intervals, and
//! random numbers that are the same on every machine.
#![forbid(unsafe_code)]

pub mod bootstrap;
pub mod metrics;
pub mod noise;
