//! The laboratory: recorded trials, the simulated plant, training, evaluation.
#![forbid(unsafe_code)]

mod noise;
pub mod plant;
pub mod trial;
