//! Errors of making a report.

use joulebus_eval::score::ScoreError;
use joulebus_train::TrainError;

/// Errors of making a report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ReportError {
    #[error("{found} {what}: allowed are {least} or more")]
    TooShort { what: &'static str, found: usize, least: usize },
    #[error("the experiments were ended before they were finished")]
    Ended,
    #[error(transparent)]
    Score(#[from] ScoreError),
    #[error(transparent)]
    Train(#[from] TrainError),
    #[error("the report cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
}
