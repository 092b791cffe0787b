//! Errors of an analysis.

use joulebus_dataset::split::SplitError;
use joulebus_dataset::trial::{ResampleError, TrialError};
use joulebus_train::linear::LinearError;

/// Reason that a dataset could not be analysed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AnalyzeError {
    /// No trial.
    #[error("found no trial to analyse. Name one or more files")]
    NoTrial,
    /// A number is out of range.
    #[error("{what} = {found}, allowed: {allowed}")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        found: usize,
        /// Allowed values.
        allowed: &'static str,
    },
    /// The data cannot be split as configured.
    #[error(transparent)]
    Split(#[from] SplitError),
    /// The data cannot be resampled as configured.
    #[error(transparent)]
    Resample(#[from] ResampleError),
    /// A recording cannot be read again.
    #[error(transparent)]
    Trial(#[from] TrialError),
    /// Moments lack a feature. Never caused by data.
    #[error(transparent)]
    Linear(#[from] LinearError),
}
