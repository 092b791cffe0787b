#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod adam;
mod chunk;
mod drives;
mod energy;
mod error;
mod kernels;
pub mod linear;
mod prepare;
mod recipe;
#[cfg(test)]
mod reference;
mod report;
mod ridge;
mod saved;
mod score;
mod settings;
mod training;
mod weights;

pub use energy::energy_model;
pub use error::TrainError;
pub use prepare::{Findings, recorded_features};
pub use recipe::{Recipe, RecipeError};
pub use report::TrainReport;
pub use saved::ResumeError;
pub use score::scored;
pub use settings::{TrainSettings, settings_for_sim};
pub use training::{Epoch, Trained, Training, train};
