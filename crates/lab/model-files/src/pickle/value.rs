//! Values of a pickle, and the recognised functions.

use std::sync::Arc;

use crate::element::Element;

/// Index of a value in its pickle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Id(pub(super) u32);

/// A value. Containers hold indices, so a value may contain itself: traversals must be bounded.
#[derive(Clone, Debug)]
pub(crate) enum Value {
    None,
    Bool(bool),
    Int(i64),
    /// An integer beyond 64 bits. Its value is not kept.
    Long,
    Float(f64),
    Text(Box<str>),
    Bytes(Box<[u8]>),
    List(Vec<Id>),
    Tuple(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    Global(Global),
    /// A function or class that is not recognised, or what a call of it would make: never made.
    Foreign(Foreign),
    DType(DType),
    /// An array before its contents are set.
    BlankArray,
    Array(Box<Array>),
    /// An array of objects: a list.
    Objects(Id),
    Storage(Box<Storage>),
    Tensor(Box<Tensor>),
    /// A layer of PyTorch with its attributes.
    Layer {
        class: &'static str,
        attributes: Option<Id>,
    },
}

/// An object of a class that is not recognised. Nobody reads it.
#[derive(Clone, Debug)]
pub(crate) struct Foreign {
    /// Offset of the opcode that names it.
    pub(crate) at: usize,
    /// Module and name as in the file.
    pub(crate) name: Arc<str>,
    /// Its arguments, state and items: none of them may be part of a network.
    pub(crate) parts: Vec<Id>,
}

/// Element type of an array. `None`: objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DType {
    pub(super) element: Option<Element>,
    pub(super) big_endian: bool,
}

/// A NumPy array whose length matches its shape.
#[derive(Clone, Debug)]
pub(crate) struct Array {
    pub(crate) shape: Vec<usize>,
    pub(crate) fortran_order: bool,
    pub(crate) element: Element,
    pub(crate) big_endian: bool,
    /// A [`Value::Bytes`].
    pub(crate) data: Id,
}

/// A storage of PyTorch, outside of the pickle.
#[derive(Clone, Debug)]
pub(crate) struct Storage {
    pub(crate) element: Element,
    pub(crate) key: Box<str>,
    /// Number of elements.
    pub(crate) count: usize,
}

/// A tensor of PyTorch: a view of a storage. Every element lies within the storage, and there are
/// no more elements than the storage has.
#[derive(Clone, Debug)]
pub(crate) struct Tensor {
    /// A [`Value::Storage`].
    pub(crate) storage: Id,
    pub(crate) offset: usize,
    pub(crate) shape: Vec<usize>,
    pub(crate) strides: Vec<usize>,
}

impl Value {
    /// An integer of any length, little-endian in two's complement.
    pub(super) fn long(bytes: &[u8]) -> Value {
        if bytes.len() > 8 {
            return Value::Long;
        }
        let fill = match bytes.last() {
            Some(last) if last & 0x80 != 0 => 0xff,
            _ => 0,
        };
        let mut word = [fill; 8];
        for (place, byte) in word.iter_mut().zip(bytes) {
            *place = *byte;
        }
        Value::Int(i64::from_le_bytes(word))
    }

    /// Type name in messages.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Value::None => "None",
            Value::Bool(_) => "a bool",
            Value::Int(_) | Value::Long => "an integer",
            Value::Float(_) => "a float",
            Value::Text(_) => "text",
            Value::Bytes(_) => "bytes",
            Value::List(_) => "a list",
            Value::Tuple(_) => "a tuple",
            Value::Dict(_) => "a dict",
            Value::Global(_) => "a function",
            Value::Foreign(_) => "a foreign object, which is not read",
            Value::DType(_) => "a dtype",
            Value::BlankArray => "an array without contents",
            Value::Array(_) => "an array",
            Value::Objects(_) => "an array of objects",
            Value::Storage(_) => "a storage",
            Value::Tensor(_) => "a tensor",
            Value::Layer { .. } => "a layer",
        }
    }
}

/// The recognised functions and classes. None of them is ever executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Global {
    OrderedDict,
    Set,
    /// `_codecs.encode`, with which old protocols write bytes.
    Encode,
    Reconstruct,
    NdArray,
    DType,
    Scalar,
    RebuildTensor,
    RebuildParameter,
    Size,
    Storage(Element),
    Layer(&'static str),
}

/// Layers of `torch.nn.modules` that are read. Activations that cannot run are refused by name
/// when the network is found.
const LAYERS: [&str; 12] = [
    "container.Sequential",
    "container.ModuleList",
    "linear.Linear",
    "activation.GELU",
    "activation.ReLU",
    "activation.Tanh",
    "activation.Sigmoid",
    "activation.SiLU",
    "activation.ELU",
    "activation.LeakyReLU",
    "dropout.Dropout",
    "linear.Identity",
];

impl Global {
    /// The function or class of this name, if it is recognised.
    pub(super) fn known(module: &str, name: &str) -> Option<Global> {
        Some(match (module, name) {
            ("collections", "OrderedDict") => Global::OrderedDict,
            ("builtins" | "__builtin__", "set") => Global::Set,
            ("_codecs", "encode") => Global::Encode,
            ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => {
                Global::Reconstruct
            }
            ("numpy.core.multiarray" | "numpy._core.multiarray", "scalar") => Global::Scalar,
            ("numpy", "ndarray") => Global::NdArray,
            ("numpy", "dtype") => Global::DType,
            ("torch._utils", "_rebuild_tensor_v2") => Global::RebuildTensor,
            ("torch._utils", "_rebuild_parameter") => Global::RebuildParameter,
            ("torch", "Size") => Global::Size,
            ("torch", class) => Global::Storage(Element::from_storage(class)?),
            _ => {
                let place = module.strip_prefix("torch.nn.modules.")?;
                let layer = LAYERS
                    .into_iter()
                    .find(|layer| layer.split_once('.') == Some((place, name)))?;
                Global::Layer(layer)
            }
        })
    }
}
