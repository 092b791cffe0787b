#![doc = include_str!("../README.md")]

mod card;
mod check;
mod error;
mod features;
mod file;
mod gelu;
mod kernel;
mod linear;
mod model;
pub mod nan;
mod network;
mod parameters;
mod persistence;
mod reading_age;
mod rollout;
pub mod simd;

pub use card::{ModelCard, ResidualStats, Scores, TrainingRange};
pub use error::{LengthError, ModelError, RolloutError};
pub use features::{FEATURE_NAMES, FEATURES, FeatureSet, Features, INPUTS, LAGS, features};
pub use file::MAX_MODEL_BYTES;
pub use gelu::Activation;
pub use kernel::{Kernel, Tiling};
pub use linear::Linear;
pub use model::Model;
pub use network::Network;
pub use parameters::{HIDDEN, Layer, Normalisation, Parameters};
pub use persistence::Persistence;
pub use reading_age::ReadingAge;
pub use rollout::{RolloutStart, Rollouts};

/// The data that a network was trained on, as its [`ModelCard`] states it. For crates that train
/// (`train`, `dataset`), that keep trained rows out of an evaluation (`eval`), and for `fleet`,
/// which leans less on the network at powers that its training did not contain.
pub mod training {
    pub use crate::card::{SIMULATED, TrainedBlocks, TrainedRows};
}
