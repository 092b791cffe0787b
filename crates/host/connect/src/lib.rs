#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod findings;
pub mod raises;
pub mod refusals;
pub mod standby;

use joulebus_bus::{Bus, JoinError, OpenError};
use joulebus_config::{Config, ConfigError};
use joulebus_settings::DomainError;

/// Joins the fleet of `config` as `name`, 1 to 128 bytes.
///
/// # Errors
/// [`ConnectError`] with the cause and the remedy.
pub fn join(config: &Config, name: &str) -> Result<Bus, ConnectError> {
    Ok(Bus::join(&config.domain()?, name)?)
}

/// Errors of connecting: of the config, of joining its fleet, of its models, or of opening a port.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The config could not be read, or is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The config names an invalid domain.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The fleet could not be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A model of the config could not be loaded: a `joulebus_models::ModelsError`. Only programs
    /// that compute load models.
    #[error(transparent)]
    Models(Box<dyn std::error::Error + Send + Sync>),
}

/// The errors contained in [`ConnectError`], and in the errors of opening ports.
pub mod error {
    pub use joulebus_bus::{
        CapacityError, FilesRemoved, IceoryxConfigError, JoinError, OpenError, ReceiveError,
        RootError, SendError, SweepError, WaitError,
    };
    pub use joulebus_config::{BundleError, ConfigError, Problem};
    pub use joulebus_settings::{DomainError, LimitsError, SettingsError};

    pub use crate::ConnectError;
}
