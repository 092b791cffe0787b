//! The laboratory: recorded trials, the simulated plant, training, evaluation, and the
//! model files of other programs.
#![forbid(unsafe_code)]

pub mod analyze;
pub mod bootstrap;
pub mod data;
pub mod evaluate;
pub mod figure;
pub mod linear;
pub mod metrics;
pub mod model_file;
mod noise;
pub mod online_learning;
pub mod plant;
pub mod report;
pub mod rows;
pub mod score;
pub mod split;
pub mod train;
pub mod trial;
