//! What a user should know about a file.

use serde::Serialize;

use crate::scan::Place;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Allowed, but worth knowing: messages out of order, a missing index.
    Note,
    /// The file is damaged, incomplete or contradicts itself.
    Error,
}

/// Something about a file that a user should know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// Where it is; nothing for what concerns the whole file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<Place>,
    /// What was found and what is allowed.
    pub what: String,
}
