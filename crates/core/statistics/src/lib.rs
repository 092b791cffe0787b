//! Statistics shared by the offline crates: error sums and quantiles, bootstrap intervals, bounds
//! of rates, and random numbers that are the same on every machine.
#![forbid(unsafe_code)]

pub mod bootstrap;
pub mod metrics;
pub mod noise;
pub mod order;
pub mod poisson;
