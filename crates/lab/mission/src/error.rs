//! Errors of missions.

use joulebus_config::ConfigError;
use joulebus_models::ModelsError;
use joulebus_plan::{AskError, Differs, PathError};

/// Reason that a mission could not be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum MissionError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Models(#[from] ModelsError),
    #[error(transparent)]
    Settings(#[from] joulebus_settings::SettingsError),
    #[error(transparent)]
    Differs(#[from] Differs),
    #[error(transparent)]
    Path(#[from] PathError),
    #[error(transparent)]
    Ask(#[from] AskError),
    #[error(transparent)]
    Rollout(#[from] joulebus_predictor::RolloutError),
    /// The fleet refused samples, which it never should.
    #[error("seed {seed}: the fleet refused {refused} samples of simulated robots")]
    Refused { seed: u64, refused: u64 },
}
