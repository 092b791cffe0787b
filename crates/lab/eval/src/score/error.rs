//! Errors of scoring.

use std::io;

use joulebus_dataset::split::SplitError;
use joulebus_dataset::trial::TrialError;
use joulebus_train::linear::LinearError;

use crate::evaluate::EvaluateError;

/// Errors of scoring.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ScoreError {
    #[error("found no recording to evaluate. Name one or more files")]
    NoRecording,
    #[error("found no model to evaluate. Name one")]
    NoModel,
    #[error(
        "none of the {rows} rows of {recordings} recordings can be evaluated: a row needs five \
         gapless readings before it, a reading after it, and a forecast. Name longer or more \
         recordings"
    )]
    NoRows { recordings: usize, rows: usize },
    #[error("{what} is {found}, allowed is {allowed}")]
    Option { what: &'static str, found: f64, allowed: &'static str },
    #[error(
        "the design belongs to other recordings: it has row {found} of recording {recording}, which has \
         {allowed} rows. Make it from the recordings that are evaluated"
    )]
    Design { recording: usize, found: usize, allowed: usize },
    #[error("the forecasts of {name}: {what}")]
    Foreign { name: String, what: String },
    #[error("{0}")]
    Recording(String),
    #[error(
        "cannot keep residuals in a temporary file in {folder}: {detail}. TMPDIR names another \
            folder"
    )]
    Kept { folder: String, detail: String },
    #[error("the evaluation was ended before it was finished")]
    Ended,
    #[error(transparent)]
    Split(#[from] SplitError),
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// A baseline's features differ from its moments'; never caused by data.
    #[error(transparent)]
    Linear(#[from] LinearError),
}

impl From<TrialError> for ScoreError {
    fn from(error: TrialError) -> Self {
        Self::Recording(error.to_string())
    }
}

impl ScoreError {
    /// Wraps an error of the temporary file.
    pub(super) fn kept(error: &io::Error) -> Self {
        Self::Kept { folder: std::env::temp_dir().display().to_string(), detail: error.to_string() }
    }
}
