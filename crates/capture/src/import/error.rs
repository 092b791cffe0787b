//! Why a recording cannot be imported.

use crate::scan::ScanError;

/// Why a recording cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// It is no MCAP file, or cannot be read.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// A topic of the mapping is not in the file, or cannot be used.
    #[error("topic {topic:?}: {why}")]
    Topic {
        /// The topic.
        topic: String,
        /// Why not.
        why: String,
    },
    /// Nothing says which topics are a robot's.
    #[error("{what}; name them with options or a mapping file")]
    Choice {
        /// What is ambiguous.
        what: String,
    },
    /// No two robots may have the same name.
    #[error("two robots named {name:?}; give them names of their own in a mapping file")]
    TwoOfAName {
        /// The name.
        name: String,
    },
}
