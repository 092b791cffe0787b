//! Simulated robots: the plant of the demo, and the paper's protocols and scenario.
#![forbid(unsafe_code)]

pub mod arena;
pub mod barrier;
mod body;
mod loads;
mod monitor;
pub mod parts;
pub mod plant;
pub mod protocol;
mod recorder;
pub mod scenario;
pub mod training_data;
