//! Training of networks that the worker loads.
//!
//! The recipe is the paper's (arXiv 2603.13908, section 5): Adam at 1e-3, batches of 256, dropout
//! 0.1, GELU, mean squared error of the normalised power, early stopping after ten epochs without
//! improvement. The arithmetic is f32 in a fixed order, sixteen numbers at a time: the same seed
//! gives the same bytes on every machine, with any number of threads.
#![forbid(unsafe_code)]

mod adam;
mod chunk;
mod energy;
mod error;
mod kernels;
pub mod linear;
mod prepare;
mod recipe;
#[cfg(test)]
mod reference;
mod report;
mod saved;
mod score;
mod settings;
mod training;
mod weights;

pub use energy::energy_model;
pub use error::TrainError;
pub use prepare::Findings;
pub use recipe::{Recipe, RecipeError};
pub use report::TrainReport;
pub use saved::ResumeError;
pub use score::scored;
pub use settings::{TrainSettings, settings_for_sim};
pub use training::{Epoch, Trained, Training, train};
