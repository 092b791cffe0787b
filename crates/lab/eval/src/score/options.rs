//! Options and errors of scoring.

use std::io;

use joulebus_dataset::split::SplitError;
use joulebus_dataset::trial::TrialError;
use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_train::linear::{LinearError, Terms};

use super::Reference;
use crate::evaluate::EvaluateError;

/// The longest horizon, ticks.
pub const MAX_HORIZON: usize = 300;
/// Maximum number of draws for confidence intervals.
const MAX_RESAMPLES: u32 = 1_000_000;

/// Options of scoring.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Horizons of the open loop, ticks, ascending, each 1 to [`MAX_HORIZON`]; empty to disable
    /// it.
    pub horizons: Vec<usize>,
    /// Rows from one origin of the open loop to the next, counted through all recordings, at
    /// least 1. A horizon of fewer ticks has its origins that far apart.
    pub origins_every: usize,
    /// Whether the energy of the next 1 to 300 s is scored too: rollouts of that length take a
    /// while.
    pub energy: bool,
    /// Linear models as baselines in addition to persistence.
    pub baselines: Vec<Terms>,
    /// Further forecasters to compare with, one tick ahead.
    pub references: Vec<Reference>,
    /// The confidence intervals.
    pub bootstrap: Bootstrap,
}

impl Default for Options {
    /// Horizons of 1 to 300 ticks in half decades, an origin every 10 rows at most, AR(5) and
    /// AR(5) + velocities.
    fn default() -> Self {
        Self {
            horizons: vec![1, 3, 10, 30, 100, 300],
            origins_every: 10,
            energy: false,
            baselines: vec![Terms::AR5, Terms::AR5_AND_VELOCITIES],
            references: Vec::new(),
            bootstrap: Bootstrap::default(),
        }
    }
}

/// Errors of scoring.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScoreError {
    /// No recording was given.
    #[error("found no recording to evaluate; name one or more files")]
    NoRecording,
    /// No model was given.
    #[error("found no model to evaluate; name one")]
    NoModel,
    /// No row can be scored.
    #[error(
        "none of the {rows} rows of {recordings} recordings can be evaluated: a row needs five \
         gapless readings before it, a reading after it, and a forecast; name longer or more \
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
         {allowed} rows; make it from the recordings that are evaluated"
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
        /// What is wrong.
        what: String,
    },
    /// A recording could not be read again.
    #[error("{0}")]
    Recording(String),
    /// The residuals of many rows could not be kept in a temporary file.
    #[error(
        "cannot keep residuals in a temporary file in {folder}: {detail}; TMPDIR names another folder"
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

impl Options {
    pub(super) fn check(&self) -> Result<(), ScoreError> {
        let mut before = 0;
        for &found in &self.horizons {
            if !(before < found && found <= MAX_HORIZON) {
                return Err(ScoreError::Horizon { found, before });
            }
            before = found;
        }
        let Bootstrap { resamples, confidence, block_rows, .. } = self.bootstrap;
        let (rows, every) = (block_rows as f64, self.origins_every as f64);
        let is_share = 0.0 < confidence && confidence < 1.0;
        let few = resamples <= MAX_RESAMPLES;
        for (what, found, fine, allowed) in [
            ("origins_every", every, every > 0.0, "1 row or more"),
            ("resamples", resamples.into(), few, "0 to 1,000,000"),
            ("block_rows", rows, rows > 0.0, "1 row or more"),
            ("confidence", confidence, is_share, "above 0 and below 1"),
        ] {
            if !fine {
                return Err(ScoreError::Option { what, found, allowed });
            }
        }
        Ok(())
    }
}
