//! Where a platform's model comes from.

use std::fmt;
use std::path::PathBuf;

/// What forecasts a platform's power.
#[derive(Clone, PartialEq)]
pub enum ModelSource {
    /// A model file, existing when the config was read.
    File(PathBuf),
    /// A model that ships: its name and the bytes of its file.
    Builtin(&'static str, &'static [u8]),
    /// The last reading again.
    Persistence {
        /// Standard deviation of the difference of two readings in a row, W.
        residual_std_w: f32,
    },
}

impl fmt::Debug for ModelSource {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(out, "File({})", path.display()),
            Self::Builtin(name, bytes) => write!(out, "Builtin({name}, {} bytes)", bytes.len()),
            Self::Persistence { residual_std_w } => {
                write!(out, "Persistence({residual_std_w} W)")
            }
        }
    }
}
