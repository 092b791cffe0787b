//! Errors of an import.

use crate::scan::ScanError;

/// Errors of an import.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The file is not MCAP, or cannot be read.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// A topic of the mapping is missing, or unusable.
    #[error("topic {topic:?}: {why}")]
    Topic {
        /// The topic.
        topic: String,
        /// The reason.
        why: String,
    },
    /// The robots' topics are ambiguous.
    #[error("{what}. Name them with options or a mapping file")]
    Choice {
        /// The ambiguity.
        what: String,
    },
    /// Two robots have the same name.
    #[error(
        "two robots named {name:?}, with the batteries {batteries}. Choose the one of its power \
            with --battery, or give \
         them different names in a mapping file"
    )]
    TwoOfAName {
        /// The name.
        name: String,
        /// Topics of their batteries.
        batteries: String,
    },
}
