//! Entries of a model file.

use std::fmt;

use super::tensor::Tensor;

/// Supported file formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Container {
    /// A joulebus model file.
    Safetensors,
    /// Tensors of another program as safetensors, such as a PyTorch state dict.
    StateDict,
    /// A NumPy array: of numbers, or of objects, which is a pickle.
    Npy,
    /// A pickle of arrays.
    Pickle,
    /// A zip archive of NumPy arrays.
    Npz,
    /// A PyTorch file since version 1.6: a zip archive with a pickle.
    TorchZip,
    /// A PyTorch file before that: five pickles and the numbers.
    TorchLegacy,
    /// A directory of NumPy arrays.
    Arrays,
    /// A joulebus model as ONNX graph.
    Onnx,
}

impl Container {
    /// True if entries are in the order in which they were written, which is the order of the
    /// layers.
    pub(crate) fn is_ordered(self) -> bool {
        !matches!(self, Container::StateDict | Container::Arrays)
    }
}

impl fmt::Display for Container {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Container::Safetensors => "safetensors",
            Container::StateDict => "state dict as safetensors",
            Container::Npy => "npy",
            Container::Pickle => "pickle",
            Container::Npz => "npz",
            Container::TorchZip => "PyTorch (zip)",
            Container::TorchLegacy => "PyTorch (legacy)",
            Container::Arrays => "directory of npy",
            Container::Onnx => "onnx",
        })
    }
}

/// One entry of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Keys and indices on the path to it, joined by dots.
    pub path: String,
    /// Its value.
    pub value: EntryValue,
}

/// Value of an entry.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum EntryValue {
    /// An array, a tensor, or lists of numbers of equal length.
    Tensor(Tensor),
    /// A number or a boolean (0 or 1).
    Number(f64),
    /// Text.
    Text(String),
    /// Another type, by name.
    Other(&'static str),
}
