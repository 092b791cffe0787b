//! Source of a platform's model.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

/// Source of a platform's model.
#[derive(Clone, PartialEq)]
pub enum ModelSource {
    /// A model file. It existed when the config was read.
    File(PathBuf),
    /// A file that is attached to the config: its path there and its bytes.
    Attached(Arc<str>, Arc<[u8]>),
    /// A built-in model: its name and the bytes of its file.
    Builtin(&'static str, &'static [u8]),
    /// Persistence.
    Persistence {
        /// Standard deviation of the difference of consecutive readings, W.
        residual_std_w: f32,
    },
}

impl fmt::Debug for ModelSource {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(out, "File({})", path.display()),
            Self::Attached(name, bytes) => write!(out, "Attached({name}, {} bytes)", bytes.len()),
            Self::Builtin(name, bytes) => write!(out, "Builtin({name}, {} bytes)", bytes.len()),
            Self::Persistence { residual_std_w } => {
                write!(out, "Persistence({residual_std_w} W)")
            }
        }
    }
}
