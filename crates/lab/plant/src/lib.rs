#![doc = include_str!("../README.md")]
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
