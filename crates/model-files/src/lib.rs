//! Model files of other programs: what is in them, the network that they hold, and the way back.
//!
//! - [`Checkpoint::read`] takes the bytes of an object array of NumPy (`.npy`, a pickle), an
//!   archive of arrays (`.npz`), a PyTorch file (`.pt`, zip or legacy) or an own model file
//!   (safetensors), and lists what is in it. Nothing in a file is ever run.
//! - [`Checkpoint::find`] finds the weights by their shapes and the statistics of the
//!   normalisation by their names.
//! - [`Found::choose`] finds out which features the network was trained on, by trying every
//!   convention on recordings, and [`Choice::network`] makes it a model that the worker loads.
//! - [`to_npz`], [`to_arrays`] and [`to_onnx`] write a model for other programs.
//!
//! Everything is a function from bytes to bytes; files and directories are the caller's.
#![forbid(unsafe_code)]

mod archive;
mod checkpoint;
mod convention;
mod element;
mod entries;
mod entry;
mod error;
mod export;
mod find;
mod names;
mod normalisation;
mod npy;
mod onnx;
mod own;
mod pickle;
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
pub use find::{Found, FoundLayer};
pub use normalisation::{FoundNormalisation, Statistics};
pub use pickle::PickleError;
pub use tensor::Tensor;
