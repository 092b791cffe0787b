//! Errors of scoring.

use std::io;

use joulebus_dataset::split::SplitError;
use joulebus_dataset::trial::TrialError;
use joulebus_train::linear::LinearError;

use crate::evaluate::EvaluateError;

/// Maximum horizon of an evaluation, ticks.
pub const MAX_HORIZON: usize = 300;

/// Errors of scoring.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScoreError {
    /// No recording was given.
    #[error("found no recording to evaluate. Name one or more files")]
    NoRecording,
    /// No model was given.
    #[error("found no model to evaluate. Name one")]
    NoModel,
    /// No row can be scored.
    #[error(
        "none of the {rows} rows of {recordings} recordings can be evaluated: a row needs five \
         gapless readings before it, a reading after it, and a forecast. Name longer or more \
         recordings"
    )]
    NoRows {
        /// Recordings.
        recordings: usize,
        /// Rows of the recordings.
        rows: usize,
    },
    /// A horizon is not allowed.
    #[error("horizon {found} after {before}: allowed are 1 to {MAX_HORIZON} ticks, ascending")]
    Horizon {
        /// The horizon.
        found: usize,
        /// The horizon before it, or 0.
        before: usize,
    },
    /// A number is not allowed.
    #[error("{what} is {found}, allowed is {allowed}")]
    Option {
        /// Name of the option.
        what: &'static str,
        /// Its value.
        found: f64,
        /// Allowed values.
        allowed: &'static str,
    },
    /// The design refers to rows that the recordings lack.
    #[error(
        "the design belongs to other recordings: it has row {found} of recording {recording}, which has \
         {allowed} rows. Make it from the recordings that are evaluated"
    )]
    Design {
        /// Index of the recording.
        recording: usize,
        /// Row of the design.
        found: usize,
        /// Rows of the recording.
        allowed: usize,
    },
    /// Another program's forecasts are refused.
    #[error("the forecasts of {name}: {what}")]
    Foreign {
        /// Its name.
        name: String,
        /// The fault.
        what: String,
    },
    /// A recording could not be read again.
    #[error("{0}")]
    Recording(String),
    /// The residuals of many rows could not be kept in a temporary file.
    #[error(
        "cannot keep residuals in a temporary file in {folder}: {detail}. TMPDIR names another \
            folder"
    )]
    Kept {
        /// The folder.
        folder: String,
        /// The operating system's error.
        detail: String,
    },
    /// The caller ended the evaluation.
    #[error("the evaluation was ended before it was finished")]
    Ended,
    /// The split is not possible.
    #[error(transparent)]
    Split(#[from] SplitError),
    /// The live path refused the settings or the trial.
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
