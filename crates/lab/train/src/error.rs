//! Errors of training.

use joulebus_predictor::ModelError;
use thiserror::Error;

/// Errors of training.
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
        /// Rows with a number that is not finite.
        unusable: usize,
        /// Rows needed.
        allowed: usize,
    },
    /// Almost all held-out rows were also trained on.
    #[error(
        "{known} of {of} held-out rows were also trained on, or belong to recordings that are copies \
         in part, so there is nothing to score. Leave copies of recordings out, or hold out others with --hold-out"
    )]
    HeldOutTrainedOn {
        /// Held-out rows that are recognised.
        known: usize,
        /// Held-out rows.
        of: usize,
    },
    /// The thread pool could not be started.
    #[error("cannot start {threads} threads: {reason}")]
    Threads {
        /// Number of threads.
        threads: usize,
        /// The error.
        reason: String,
    },
    /// The loss is not finite.
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
        /// Allowed values.
        allowed: &'static str,
    },
    /// The power is constant, so there is nothing to learn.
    #[error("the power of all {rows} training rows is {power_w} W. A varying power is needed")]
    ConstantPower {
        /// Number of training rows.
        rows: usize,
        /// Their power, W.
        power_w: f32,
    },
    /// The predictor refused the trained network.
    #[error("the finished network was refused")]
    Model(#[from] ModelError),
}
