#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod analyze;
pub mod energy;
pub mod evaluate;
mod report;
pub mod score;
pub mod training_data;
pub mod trips;

pub use report::EvalReport;
