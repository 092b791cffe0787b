//! Errors of writing captures.

use std::path::PathBuf;

use mcap::McapError;

/// Errors of writing.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum WriteError {
    /// There is a file of that name.
    #[error(
        "{path:?} exists and is not touched. Name another file, or begin its next part \
         (`joulebus record --resume`)"
    )]
    Exists { path: PathBuf },
    /// The file could not be created.
    #[error("cannot create {path:?}: {source}")]
    Create { path: PathBuf, source: std::io::Error },
    /// Writing failed: the file written so far can be recovered.
    #[error("cannot write the capture: {reason}")]
    Failed { reason: String },
    /// An earlier write failed.
    #[error("the capture has stopped: an earlier write failed")]
    Stopped,
    /// The message is of another program's kind.
    #[error("only messages of this program's own kinds can be written")]
    NotOurs,
    /// More channels than a file can have.
    #[error(
        "more than {allowed} channels in one file. Record fewer robots with channels of their own"
    )]
    TooManyChannels { allowed: usize },
}

/// The error as text, with the operating system's, which mcap's text omits.
pub(crate) fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(source) => source.to_string(),
        error => error.to_string(),
    }
}
