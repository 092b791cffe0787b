//! Errors of training.

use joulebus_predictor::ModelError;
use thiserror::Error;

/// Errors of training.
#[derive(Debug, Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum TrainError {
    #[error(
        "the {part} part has {found} usable rows ({unusable} more have a NaN or infinite number), \
         at least {allowed} are needed"
    )]
    TooFewRows { part: &'static str, found: usize, unusable: usize, allowed: usize },
    #[error(
        "{known} of {of} held-out rows were also trained on, or belong to recordings that are copies \
         in part, so there is nothing to score. Leave copies of recordings out, or hold out others with --hold-out"
    )]
    HeldOutTrainedOn { known: usize, of: usize },
    #[error("cannot start {threads} threads: {reason}")]
    Threads { threads: usize, reason: String },
    #[error("the loss of epoch {epoch} is {loss}: a smaller `learning_rate` may help")]
    Diverged {
        /// The epoch, from 1.
        epoch: u32,
        loss: f64,
    },
    #[error("`{setting}` is {found}, allowed: {allowed}")]
    Setting { setting: &'static str, found: f64, allowed: &'static str },
    #[error("the power of all {rows} training rows is {power_w} W. A varying power is needed")]
    ConstantPower {
        rows: usize,
        /// Their power, W.
        power_w: f32,
    },
    #[error("the finished network was refused")]
    Model(#[from] ModelError),
}
