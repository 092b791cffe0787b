//! Model files of other programs: reading, finding the network, import and export.
//!
//! Pure: all functions map bytes to bytes. File access is left to the caller, and no code in a file
//! is ever executed.
//!
//! ```
//! use joulebus_model_files::{Checkpoint, Container, to_npz};
//! # use joulebus_predictor::FeatureSet;
//! # let network = joulebus_testkit_networks::random::network(7, FeatureSet::Full);
//!
//! // `network` is a `joulebus_predictor::Network`.
//! let archive = to_npz(&network)?;
//! let checkpoint = Checkpoint::read(&archive)?;
//! assert_eq!(checkpoint.container, Container::Npz);
//! let read = checkpoint.network.ok_or("the archive has no network")?;
//! assert_eq!(to_npz(&read)?, archive);
//! assert!(Checkpoint::read(&archive[..100]).is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know**, one for each step of an import:
//!
//! - [`Checkpoint::read`] reads an object array of NumPy (`.npy`, a pickle), an archive of arrays
//!   (`.npz`), a PyTorch file (`.pt`, zip or legacy, or a state dict as safetensors) or a joulebus
//!   model (safetensors, or exported), and lists its entries.
//! - [`Checkpoint::find`] returns [`Found`]: the weights by their shapes, the statistics of the
//!   normalisation by their names, and the activation that the file states. Smaller networks than
//!   the worker's are padded with the same result. Larger ones are refused.
//! - [`Found::choose`] returns a [`Choice`]: the network's feature convention, identified by its
//!   statistics and by evaluating what remains on recordings. [`Choice::network`] converts it to a
//!   model for the worker.
//!
//! **Export.** [`to_npz`], [`to_arrays`], [`to_onnx`] and [`to_python`] write a model for other
//! programs.
//!
//! **Units.** Models of the worker use SI. A foreign model's [`Convention`] states which units it
//! has.
//!
//! **Errors** name the location in the file, what was found and what is allowed: [`ReadError`],
//! [`FindError`], [`ChooseError`], [`ExportError`].
//!
//! **In the book**: [train, compare and export models][1], [our own reader reads pickles][2],
//! [imported networks][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/models.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/pickle.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/imported-models.md
#![forbid(unsafe_code)]

mod activation;
mod archive;
mod checkpoint;
mod convention;
mod element;
mod entries;
mod entry;
mod error;
mod export;
mod find;
mod layers;
mod names;
mod normalisation;
mod npy;
mod onnx;
mod own;
mod padding;
mod pickle;
mod python;
mod state_dict;
mod tensor;
mod torch;

pub use checkpoint::Checkpoint;
pub use convention::{
    Choice, ChooseError, Convention, Derivative, LagOrder, Lags, Magnitude, Origin, PowerUnit,
    Ranked,
};
pub use entry::{Container, Entry, EntryValue};
pub use error::{FindError, MAX_FILE_BYTES, ReadError};
pub use export::{CHECK_ROWS, ExportError, to_arrays, to_npz, to_onnx};
pub use find::{ActivationFrom, Found, FoundLayer};
pub use normalisation::{FoundNormalisation, Statistics, StatisticsFrom};
pub use pickle::PickleError;
pub use python::to_python;
pub use tensor::Tensor;
