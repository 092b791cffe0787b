//! Why a file could not be read, or holds no network.

use joulebus_predictor::ModelError;

use super::entry::Container;
use super::pickle::PickleError;

/// Largest file that is read, in bytes: a checkpoint of this network with its optimizer has some
/// 100 kB.
pub const MAX_FILE_BYTES: usize = 16 << 20;

/// Why a file could not be read. The caller adds the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// Far larger than any model of this kind.
    #[error("the file has {found} bytes, at most {MAX_FILE_BYTES} are read; is it another file?")]
    TooLarge {
        /// Bytes found.
        found: usize,
    },
    /// None of the kinds that are read.
    #[error(
        "byte 0: {found}; expected a NumPy file (.npy, .npz), a PyTorch file (.pt, .pth) or a model of \
         joulebus (.safetensors)"
    )]
    Kind {
        /// What was found.
        found: String,
    },
    /// A part of the file is damaged or of another kind.
    #[error("{container}, {part}: {detail}")]
    Part {
        /// Kind of the file.
        container: Container,
        /// The part, with its place.
        part: String,
        /// What was found and what is allowed.
        detail: String,
    },
    /// A pickle in the file was refused.
    #[error("{container}, {part}: {source}")]
    Pickle {
        /// Kind of the file.
        container: Container,
        /// The part of the file that the pickle is.
        part: String,
        /// Why.
        source: PickleError,
    },
    /// An own model file was refused.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Why no network was found in a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// No part of the file has the arrays of the network.
    #[error(
        "no part of the file has exactly the arrays of the network (weights 64×11 or 64×5, 64×64, \
         32×64, 1×32, all of them or none transposed; biases 64, 64, 32, 1); a network that reads \
         freshness comes as an own model only; found: {found}"
    )]
    NoNetwork {
        /// The arrays found, with their shapes.
        found: String,
    },
    /// Several parts of the file have.
    #[error("several parts of the file hold a network: {found}; name one of them")]
    Several {
        /// The parts.
        found: String,
    },
    /// The part that was asked for is not there.
    #[error("no part of the file is called {asked:?}; parts: {found}")]
    NoSuchPart {
        /// What was asked for.
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
    /// The activation is another one, or not the same everywhere.
    #[error(
        "{path:?} is {found:?}, allowed: \"none\" (GELU by the error function) or \"tanh\", the same \
         in every layer"
    )]
    Activation {
        /// The setting.
        path: String,
        /// Its value.
        found: String,
    },
    /// Some statistics of the normalisation are there and some are not.
    #[error("the normalisation is incomplete: found {found}; missing: {missing}")]
    Normalisation {
        /// The statistics found.
        found: String,
        /// Those missing.
        missing: String,
    },
    /// A statistic cannot be one.
    #[error("{path:?} is {value}, allowed for {what}: {allowed}")]
    Statistic {
        /// Where it stands.
        path: String,
        /// Its value.
        value: f64,
        /// What it is.
        what: &'static str,
        /// What is allowed.
        allowed: &'static str,
    },
}
