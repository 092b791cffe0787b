//! Findings about a file.

use serde::Serialize;

use crate::scan::RecordLocation;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Valid but noteworthy: messages out of order or missing.
    Note,
    /// The file is corrupt, incomplete or inconsistent.
    Error,
}

/// A finding about a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Its severity.
    pub severity: Severity,
    /// Its location. `None` if it concerns the whole file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<RecordLocation>,
    /// The found and the allowed value, in words.
    pub what: String,
}
