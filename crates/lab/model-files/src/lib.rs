#![doc = include_str!("../README.md")]
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
