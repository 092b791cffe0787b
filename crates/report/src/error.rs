//! Why there is no report.

use crate::figure::FigureError;
use joulebus_eval::evaluate::EvaluateError;
use joulebus_eval::score::ScoreError;
use joulebus_train::TrainError;

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The course is too short to be evaluated.
    #[error("{found} {what}: allowed are 100 or more")]
    TooShort {
        /// What.
        what: &'static str,
        /// How many.
        found: usize,
    },
    /// The evaluation was refused.
    #[error(transparent)]
    Score(#[from] ScoreError),
    /// The live path refused.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// The training was refused or went astray.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A picture could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// The report could not be written as JSON.
    #[error("the report cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
}
