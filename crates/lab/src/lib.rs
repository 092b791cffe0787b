//! The laboratory: recorded trials, the simulated plant, training, evaluation.
#![forbid(unsafe_code)]

pub mod evaluate;
mod noise;
pub mod plant;
pub mod train;
pub mod trial;
