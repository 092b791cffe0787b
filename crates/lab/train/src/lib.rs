//! Training of networks that the worker loads.
//!
//! ```
//! use joulebus_dataset::rows::{Dataset, Row};
//! use joulebus_predictor::features;
//! use joulebus_train::{TrainSettings, train};
//!
//! let rows: Vec<Row> = (0..60)
//!     .map(|at| {
//!         let power_w = |at: usize| 4.0 + 0.1 * (at % 7) as f32;
//!         let lags_w = [4, 3, 2, 1, 0].map(|before| power_w(at + before));
//!         Row::new(features(0.2, 0.0, None, &lags_w), power_w(at + 5))
//!     })
//!     .collect();
//! let dataset = Dataset {
//!     training: rows[..40].to_vec(),
//!     validation: rows[40..50].to_vec(),
//!     held_out: rows[50..].to_vec(),
//!     description: "an example".to_owned(),
//!     period_s: 0.1,
//! };
//! let settings = TrainSettings { max_epochs: 2, ..TrainSettings::default() };
//! let trained = train(&dataset, &settings, |epoch| println!("epoch {}", epoch.number))?;
//! assert_eq!(trained.epochs.len(), 2);
//! // The bytes of the model's file are the same on every machine.
//! assert!(!trained.network.to_safetensors()?.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** [`TrainSettings`] has the hyperparameters. A [`Training`] is a run that
//! can be saved and resumed after each epoch. A [`Trained`] has the network of the best epoch.
//!
//! **The recipe** is the paper's (arXiv 2603.13908, section 5): Adam at 1e-3, batches of 256,
//! dropout 0.1, GELU, mean squared error of the normalised power, early stopping after ten epochs
//! without improvement. The arithmetic is f32 in a fixed order, sixteen numbers at a time: the same
//! seed gives the same bytes on every machine, with any number of threads.
//!
//! **Baselines.** [`linear`] fits linear forecasters. [`energy_model`] fits a platform's energy
//! model.
//!
//! **Units** are W, s, m/s and rad/s.
//!
//! **Errors** state the setting or the part of the rows, what was found and what is allowed
//! ([`TrainError`], [`RecipeError`], [`ResumeError`]). Rows that cannot be used are counted
//! ([`Findings`]).
//!
//! **In the book**: [train, compare and export models][1], [models that ship][2], [single
//! precision, the same bits everywhere][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/models.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/models.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/training-evaluation.md#the-trainer-computes-in-single-precision-with-the-same-bits-everywhere
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
pub use prepare::{Findings, recorded_features};
pub use recipe::{Recipe, RecipeError};
pub use report::TrainReport;
pub use saved::ResumeError;
pub use score::scored;
pub use settings::{TrainSettings, settings_for_sim};
pub use training::{Epoch, Trained, Training, train};
