//! Errors of missions.

use joulebus_config::ConfigError;
use joulebus_models::ModelsError;
use joulebus_plan::{AskError, Differs, PathError};

/// Reason that a mission could not be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum MissionError {
    /// The fleet's config.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Its models.
    #[error(transparent)]
    Models(#[from] ModelsError),
    /// Its settings.
    #[error(transparent)]
    Settings(#[from] joulebus_settings::SettingsError),
    /// The planner's settings or models are not the fleet's.
    #[error(transparent)]
    Differs(#[from] Differs),
    /// A path.
    #[error(transparent)]
    Path(#[from] PathError),
    /// A question.
    #[error(transparent)]
    Ask(#[from] AskError),
    /// A rollout of the network.
    #[error(transparent)]
    Rollout(#[from] joulebus_predictor::RolloutError),
    /// The fleet refused samples, which it never should.
    #[error("seed {seed}: the fleet refused {refused} samples of simulated robots")]
    Refused { seed: u64, refused: u64 },
}
