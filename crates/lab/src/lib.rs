//! The laboratory: recorded trials, the simulated plant, training, evaluation.
#![forbid(unsafe_code)]

pub mod evaluate;
mod noise;
pub mod plant;
pub mod rows;
pub mod split;
pub mod train;
pub mod trial;
