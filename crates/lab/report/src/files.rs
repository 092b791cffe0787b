//! The files of a report, in memory.

use super::ReportError;
use super::document::Document;
use super::html::html;

/// A file of a report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct File {
    /// Its name in the report's directory.
    pub name: &'static str,
    /// Its contents.
    pub text: String,
}

/// `report.html`, `report.json` and `report.txt`.
///
/// # Errors
/// The report cannot be written as JSON.
pub fn files(document: &Document) -> Result<[File; 3], ReportError> {
    let file = |name, text| File { name, text };
    Ok([
        file("report.html", html(document)?),
        file("report.json", serde_json::to_string_pretty(document)?),
        file("report.txt", document.to_string()),
    ])
}
