//! Training: rows in, a network that the worker loads out.
//!
//! The recipe is the paper's (arXiv 2603.13908, section 5): Adam at 1e-3, batches of 256, dropout
//! 0.1, GELU, mean squared error of the normalised power, early stopping after ten epochs without
//! progress. The arithmetic is f32 in a fixed order, sixteen numbers at a time: the same seed gives
//! the same bytes on every machine, with any number of threads.

mod adam;
mod chunk;
mod dataset;
mod error;
mod kernels;
#[cfg(test)]
mod reference;
mod saved;
mod score;
mod settings;
mod simulated;
mod training;
mod weights;

pub use dataset::{Dataset, Findings, Row};
pub use error::TrainError;
pub use saved::ResumeError;
pub use score::scored;
pub use settings::TrainSettings;
pub use simulated::{SimulatedData, dataset_from_plant, settings_for_sim, train_sim};
pub use training::{Epoch, Trained, Training, train};
