//! Errors of an import.

use crate::scan::ScanError;

/// Errors of an import.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The file is not MCAP, or cannot be read.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// The recording has not the robots and topics of the mapping, or several that could be meant.
    #[error("{0}")]
    Robots(String),
}
