//! The network that forecasts a robot's electrical power, and its baselines.
//!
//! Pure: no clock, file, thread or shared memory. Input are the bytes of a model file, output are
//! forecasts in watt.
//!
//! - [`features`](features()) builds one row of inputs in SI units.
//! - [`ReadingAge`] tracks the age of the newest reading and when the next one is due.
//! - [`Model::predict`] turns any number of rows into as many forecasts, and
//!   [`Model::predict_columns`] does so from one column for each feature.
//! - [`Model::rollout`] feeds a model with its own forecasts, to compute the energy of a command
//!   sequence.
//! - [`Network`] is the model of arXiv 2603.13908, section 5: 11→64→64→32→1 with GELU.
//!
//! None of them allocates, and all are thread-safe.
//!
//! **One arithmetic.** A robot's forecast depends on that robot's row alone and has the same bits
//! for every batch size, every position in the batch, every tiling and every vector width, in rows,
//! columns and rollouts; the scalar [`Network::predict_reference_f32`] is the definition that the
//! kernels are tested against. Every NaN forecast is [`f32::NAN`] ([`nan::canonical`]).
//!
//! [`simd`] and [`nan`] are for loops beside the network that must have the same bits on every
//! processor, as the fleet's tick has.

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
mod seen_power;
pub mod simd;

pub use card::{
    ModelCard, ResidualStats, SIMULATED, Scores, TrainedBlocks, TrainedRows, TrainingRange,
};
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
pub use reading_age::{ReadingAge, missing_steps};
pub use rollout::{RolloutStart, Rollouts};
pub use seen_power::SeenPower;
