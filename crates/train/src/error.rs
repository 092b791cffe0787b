//! Why nothing was trained.

use joulebus_predictor::ModelError;
use thiserror::Error;

/// Why nothing was trained.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A part of the dataset is too small.
    #[error(
        "the {part} part has {found} usable rows ({unusable} more have a NaN or infinite number), \
         at least {allowed} are needed"
    )]
    TooFewRows {
        /// Part of the dataset.
        part: &'static str,
        /// Rows found.
        found: usize,
        /// Rows that cannot be used.
        unusable: usize,
        /// Rows needed.
        allowed: usize,
    },
    /// There are no threads to compute with.
    #[error("cannot start {threads} threads: {reason}")]
    Threads {
        /// Threads wanted.
        threads: usize,
        /// What stands in the way.
        reason: String,
    },
    /// The loss is no number any more.
    #[error("the loss of epoch {epoch} is {loss}: a smaller `learning_rate` may help")]
    Diverged {
        /// The epoch, from 1.
        epoch: u32,
        /// Its validation loss.
        loss: f64,
    },
    /// A setting is out of range.
    #[error("`{setting}` is {found}, allowed: {allowed}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// The value found.
        found: f64,
        /// What is accepted.
        allowed: &'static str,
    },
    /// The power never changes, so there is nothing to learn.
    #[error("the power of all {rows} training rows is {power_w} W; a varying power is needed")]
    ConstantPower {
        /// Number of training rows.
        rows: usize,
        /// Their power.
        power_w: f32,
    },
    /// The finished network was refused.
    #[error("the finished network was refused")]
    Model(#[from] ModelError),
}
