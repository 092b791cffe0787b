//! Errors of reading a file and of finding its network.

use joulebus_predictor::ModelError;

use super::entry::Container;
use super::pickle::PickleError;

/// Maximum size of a file to import, bytes: a checkpoint of this network with its optimizer has
/// some 100 kB.
pub const MAX_FILE_BYTES: usize = 16 << 20;

/// Errors of reading a file. The caller adds the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// Larger than any model of this kind.
    #[error(
        "the file has {found} bytes, at most {MAX_FILE_BYTES} are read. Check that it is a model \
            file"
    )]
    TooLarge {
        /// Bytes found.
        found: usize,
    },
    /// None of the supported formats.
    #[error(
        "byte 0: {found}, expected a NumPy file (.npy, .npz), a PyTorch file (.pt, .pth), tensors \
         (.safetensors) or a model that joulebus exported (.onnx)"
    )]
    Kind {
        /// The arrays found.
        found: String,
    },
    /// A part of the file is corrupt or has an unexpected type.
    #[error("{container}, {part}: {detail}")]
    Part {
        /// Format of the file.
        container: Container,
        /// The part, with its location.
        part: String,
        /// The problem with the expected value.
        detail: String,
    },
    /// A pickle in the file was refused.
    #[error("{container}, {part}: {source}")]
    Pickle {
        /// Format of the file.
        container: Container,
        /// The part of the file that contains the pickle.
        part: String,
        /// The reason.
        source: PickleError,
    },
    /// A joulebus model file was refused.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Errors of finding a network in a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// No part of the file has the arrays of the network.
    #[error(
        "no part of the file has exactly the arrays of a network, found: {found}. A network has one to \
         three hidden layers of at most 64, 64 and 32 units. Each layer has biases, and weights from \
         11 or 5 inputs to one output, all of them or none transposed. No other array has these \
         sizes. A network that reads the age of a reading is read only from a file of \
         joulebus"
    )]
    NoNetwork {
        /// The arrays found, with their shapes.
        found: String,
    },
    /// The network is larger than the worker's.
    #[error(
        "the network is {found}. The worker runs 11→64→64→32→1 or smaller: 11 inputs, or the 5 \
         readings alone, and one to three hidden layers of at most 64, 64 and 32 units. Train a \
         smaller one"
    )]
    TooLarge {
        /// Its widths, such as `11→128→64→32→1`.
        found: String,
    },
    /// Several parts of the file have them.
    #[error("several parts of the file hold a network: {found}. Name one of them")]
    Several {
        /// The parts.
        found: String,
    },
    /// The requested part does not exist.
    #[error("no part of the file is called {asked:?}, parts: {found}")]
    NoSuchPart {
        /// The requested part.
        asked: String,
        /// The parts.
        found: String,
    },
    /// A weight or bias is NaN, infinite or too large for f32.
    #[error("{path:?} has {value} at position {index}, allowed: finite numbers of f32")]
    NotFinite {
        /// The array.
        path: String,
        /// Position in C order.
        index: usize,
        /// The value.
        value: f64,
    },
    /// The activation is unsupported.
    #[error(
        "{path:?} states the activation {found:?}, which the worker does not have, allowed: \
            {allowed}, \
         or gelu, which is gelu_erf. If this is not about the hidden layers, name theirs with \
         --activation",
        allowed = joulebus_predictor::Activation::NAMES
    )]
    Activation {
        /// The setting.
        path: String,
        /// Its value.
        found: String,
    },
    /// Statements of the activation contradict each other.
    #[error(
        "{first}, but {second}, allowed: one activation in all hidden layers, or name it with \
            --activation"
    )]
    ActivationsDiffer {
        /// A statement.
        first: String,
        /// Another.
        second: String,
    },
    /// The output has an activation.
    #[error(
        "{path:?} is {found:?}: the output has no activation here, allowed: identity, linear, none"
    )]
    OutputActivation {
        /// The setting.
        path: String,
        /// Its value.
        found: String,
    },
    /// The weights are a product of other arrays.
    #[error(
        "{path:?} is a factor of weights (weight_norm or another parametrisation). Save the \
            weights themselves: \
         `torch.nn.utils.parametrize.remove_parametrizations(layer, 'weight')`, or `remove_weight_norm(layer)`, \
         of each such layer before `state_dict()`"
    )]
    Parametrised {
        /// An array of it.
        path: String,
    },
    /// The network has layers that are not run.
    #[error(
        "{path:?} belongs to a normalisation layer. The worker runs dense layers alone: fold it \
            into the \
         layer beside it, or train without it"
    )]
    NormalisationLayer {
        /// An array of it.
        path: String,
    },
    /// Some statistics of the normalisation are missing.
    #[error("the normalisation is incomplete: found {found}, missing: {missing}")]
    Normalisation {
        /// The statistics found.
        found: String,
        /// The missing parts.
        missing: String,
    },
    /// A statistic has an invalid value.
    #[error("{path:?} is {value}, allowed for {what}: {allowed}")]
    Statistic {
        /// Its path.
        path: String,
        /// Its value.
        value: f64,
        /// The statistic.
        what: &'static str,
        /// Allowed values.
        allowed: &'static str,
    },
}
