//! Errors of importing a network.

use joulebus_predictor::ModelError;

use crate::convention::Convention;

/// Errors of importing a plain network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ImportError {
    #[error(
        "the recordings have {found} readings with all inputs of a forecast (command, five \
         readings before it, no gap), at least {allowed} are needed"
    )]
    TooFewRows { found: usize, allowed: usize },
    #[error("all {rows} readings are the same. Recordings with changing power are needed")]
    ConstantPower { rows: usize },
    #[error(
        "as stated, the network has R² {r2:.4} on these {rows} readings, no better than a \
         constant, and no other convention fits better. Check the statistics, and that the \
         recordings are of the robots that it was trained for"
    )]
    NothingFits { r2: f64, rows: usize },
    #[error(
        "the recordings contradict the stated convention: R² {stated_r2:.4}, and R² {r2:.4} \
         ({less:.0} % less squared error) with another one. Check what the author of the network \
         did. If this is it, convert it again with {better}"
    )]
    Contradicted {
        stated_r2: f64,
        better: Convention,
        r2: f64,
        /// By how much its squared error is smaller, %.
        less: f64,
    },
    #[error(
        "the recordings contradict the stated convention: R² {stated_r2:.4}, and R² {r2:.4} if the \
         magnitudes are those of normalised velocities. That cannot run here: it needs |v − mean|, \
         and the worker's features hold |v|. Train the network with |v|"
    )]
    CannotRun { stated_r2: f64, r2: f64 },
    #[error(transparent)]
    Model(#[from] ModelError),
}
