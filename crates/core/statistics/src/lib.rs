#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod bootstrap;
pub mod metrics;
pub mod noise;
pub mod order;
pub mod poisson;
