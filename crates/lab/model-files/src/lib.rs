//! Networks of other programs in, models of joulebus out.
//!
//! Pure: all functions map bytes to bytes. File access is left to the caller.
//!
//! **Import.** Files of PyTorch, ONNX and NumPy are converted in Python, by
//! `joulebus.models.convert`. It writes a *plain network*: safetensors with fixed names, and the
//! feature convention that its author states. [`Plain::read`] reads it, and [`Plain::import`]
//! checks the convention on recordings and makes a model for the worker. Smaller networks than the
//! worker's are padded with the same result. Larger ones are refused.
//!
//! **Export.** [`to_npz`], [`to_arrays`], [`to_onnx`] and [`to_python`] write a model for other
//! programs.
//!
//! ```
//! use joulebus_model_files::{Plain, to_arrays};
//! # use joulebus_predictor::FeatureSet;
//! # let network = joulebus_testkit_networks::random::network(7, FeatureSet::Full);
//!
//! // `network` is a `joulebus_predictor::Network`.
//! let arrays = to_arrays(&network)?;
//! assert!(arrays.iter().any(|(name, _)| name == "layers.0.weight"));
//! assert!(Plain::read(b"no network").is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Units.** Models of the worker use SI. A plain network's [`Convention`] states which units it
//! has.
//!
//! **Errors** name what was found and what is allowed: [`PlainError`], [`ImportError`],
//! [`ExportError`].
//!
//! **In the book**: [train, compare and export models][1], [imported networks][2].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/models.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/models-reports.md#networks-of-others-are-converted-in-python-as-stated
#![forbid(unsafe_code)]

mod arrays;
mod convention;
mod error;
mod export;
mod import;
mod npz;
mod onnx;
mod padding;
mod plain;
mod python;
mod score;

pub use convention::{
    CommandConvention, Convention, Derivative, LagOrder, Lags, Magnitude, PowerUnit,
};
pub use error::ImportError;
pub use export::{CHECK_ROWS, ExportError, to_arrays, to_npz, to_onnx};
pub use import::{Imported, Ranked};
pub use plain::{MAX_FILE_BYTES, Plain, PlainError};
pub use python::to_python;
