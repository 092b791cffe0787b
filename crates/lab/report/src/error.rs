//! Errors of making a report.

use joulebus_eval::evaluate::EvaluateError;
use joulebus_eval::score::ScoreError;
use joulebus_train::TrainError;

/// Errors of making a report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ReportError {
    /// The simulated experiment is too short to be evaluated.
    #[error("{found} {what}: allowed are {least} or more")]
    TooShort { what: &'static str, found: usize, least: usize },
    /// The caller ended the experiments.
    #[error("the experiments were ended before they were finished")]
    Ended,
    /// The evaluation was refused.
    #[error(transparent)]
    Score(#[from] ScoreError),
    /// The live path refused the settings or a trial.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// The training was refused or diverged.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The report could not be written as JSON.
    #[error("the report cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
}
