//! The network that forecasts a robot's electrical power, and its baselines.
//!
//! Pure: no clock, file, thread or shared memory. The input is the bytes of a model file, the
//! output is forecasts in watt.
//!
//! ```
//! use joulebus_predictor::{Model, Persistence, ResidualStats, features};
//!
//! let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
//! let model = Model::Persistence(Persistence::new(residual)?);
//! let row = features(0.2, 0.0, None, &[4.2, 4.0, 4.0, 4.0, 4.0]);
//! let mut forecast_w = [0.0];
//! model.predict(&[row], &mut forecast_w);
//! assert_eq!(forecast_w, [4.2]);
//! # Ok::<(), joulebus_predictor::ModelError>(())
//! ```
//!
//! **Three types to know.** A [`Model`] turns any number of rows into as many forecasts
//! ([`Model::predict`], or [`Model::predict_columns`] from one column for each feature).
//! [`Model::rollout`] feeds it with its own forecasts, to compute the energy of a command sequence.
//! A [`Network`] is the model of arXiv 2603.13908, section 5: 11→64→64→32→1 with GELU.
//! [`ReadingAge`] tracks the age of the newest reading and when the next one is due.
//! [`features`](features()) builds one row of inputs.
//!
//! None of them allocates, and all are thread-safe.
//!
//! **Units** are SI: W, J, m/s, rad/s, s. Unknown values are NaN.
//!
//! **One arithmetic.** A robot's forecast depends on that robot's row alone. It has the same bits
//! for every batch size, position in the batch, tiling and vector width, in rows, columns and
//! rollouts. The scalar [`Network::predict_reference_f32`] is the definition that the kernels are
//! tested against. Every NaN forecast is [`f32::NAN`] ([`nan::canonical`]).
//!
//! [`simd`] and [`nan`] are for loops beside the network that must have the same bits on every
//! processor, as the fleet's tick has.
//!
//! **Errors** name the part of the file, the found and the allowed value ([`ModelError`]). Rollouts
//! check their shapes ([`RolloutError`]).
//!
//! **In the book**: [models that ship][1], [train, compare and export models][2], [four
//! implementations of the network, one result][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/models.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/models.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/the-tick.md#four-implementations-of-the-network-one-result

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
