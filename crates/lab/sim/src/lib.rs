#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod barrier;
pub mod protocol;
mod recorder;
pub mod scenario;
pub mod training_data;
