//! Offline evaluation: forecasts of recordings by the live code, scores with intervals, and
//! analysis of datasets.
#![forbid(unsafe_code)]

pub mod analyze;
pub mod calibrate;
pub mod energy;
pub mod evaluate;
pub mod online_learning;
mod part;
mod report;
pub mod score;
pub mod training_data;

pub use part::{EvalPart, Merged, PartError};
pub use report::EvalReport;
