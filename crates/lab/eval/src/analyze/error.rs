//! Errors of an analysis.

use joulebus_dataset::split::SplitError;
use joulebus_dataset::trial::{ResampleError, TrialError};
use joulebus_train::linear::LinearError;

/// Reason that a dataset could not be analysed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum AnalyzeError {
    #[error("found no trial to analyse. Name one or more files")]
    NoTrial,
    #[error("{what} = {found}, allowed: {allowed}")]
    Setting { what: &'static str, found: usize, allowed: &'static str },
    #[error(transparent)]
    Split(#[from] SplitError),
    #[error(transparent)]
    Resample(#[from] ResampleError),
    #[error(transparent)]
    Trial(#[from] TrialError),
    #[error(transparent)]
    Linear(#[from] LinearError),
}
