//! Simulated robots: their loads, battery and monitor, the paper's protocols, and a live fleet.
//!
//! `joulebus-sim` records them as trials. This crate needs neither files nor linear algebra, so
//! that the demo compiles little.
#![forbid(unsafe_code)]

pub mod arena;
pub mod body;
pub mod driven;
mod fault;
mod loads;
pub mod monitor;
pub mod parts;
mod plant;
pub mod protocol;

pub use fault::Fault;
pub use plant::{Plant, PlantError, SimReading};
