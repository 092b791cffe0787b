//! Simulated robots: the paper's protocols and scenario, and a live fleet that drives them.
#![forbid(unsafe_code)]

pub mod arena;
pub mod barrier;
mod body;
pub mod driven;
mod fault;
mod loads;
mod monitor;
pub mod parts;
pub mod plant;
pub mod protocol;
mod recorder;
pub mod scenario;
pub mod training_data;
