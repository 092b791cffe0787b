//! Model files of other programs: reading, finding the network, import and export.
//!
//! - [`Checkpoint::read`] reads an object array of NumPy (`.npy`, a pickle), an archive of arrays
//!   (`.npz`), a PyTorch file (`.pt`, zip or legacy, or a state dict as safetensors) or a joulebus
//!   model (safetensors, or exported), and lists its entries. No code in a file is ever executed.
//! - [`Checkpoint::find`] finds the weights by their shapes, the statistics of the normalisation by
//!   their names, and the activation that the file states. Smaller networks than the worker's are
//!   padded with the same result; larger ones are refused.
//! - [`Found::choose`] identifies the network's feature convention by its statistics and by
//!   evaluating what remains on recordings, and [`Choice::network`] converts it to a model for the
//!   worker.
//! - [`to_npz`], [`to_arrays`], [`to_onnx`] and [`to_python`] write a model for other programs.
//!
//! All functions map bytes to bytes; file access is left to the caller.
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
