//! The laboratory: recorded trials, the simulated plant, training, evaluation.
#![forbid(unsafe_code)]

pub mod trial;
