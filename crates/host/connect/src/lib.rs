//! Joining the fleet of a config. The config itself is plain values, and knows no shared memory.
//!
//! `joulebus-publisher`, `joulebus-consumer`, `joulebus-planner` and all programs join so. A
//! program of yours uses one of those three.
//!
//! ```no_run
//! let config = joulebus_config::Config::load("configs/fleet.toml")?;
//! let bus = joulebus_connect::join(&config, "my-program")?;
//! println!("a member of {}", bus.domain().fleet());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **To know.** [`join`](join()) returns a [`Bus`], which opens ports. A [`ConnectError`] is the
//! error of all that happens at the start of a member. A [`FindingsFile`](findings::FindingsFile)
//! carries what a source finds implausible to the readers of its fleet.
//!
//! **Units.** There are none.
//!
//! **Errors** state the cause and the remedy. [`error`] has all errors that a [`ConnectError`]
//! contains.
//!
//! **In the book**: [config, every key][1], [files and shared memory][2], [findings of sources
//! reach readers by a file][3], [troubleshooting][4].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/config.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/files.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/forecasts-batteries-alarms.md#findings-of-sources-reach-readers-by-a-file-not-by-shared-memory
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/troubleshooting.md
#![forbid(unsafe_code)]

pub mod findings;
pub mod raises;

use joulebus_bus::{Bus, JoinError, OpenError};
use joulebus_config::{Config, ConfigError};
use joulebus_domain::DomainError;

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
    pub use joulebus_domain::{DomainError, LimitsError};
    pub use joulebus_settings::SettingsError;

    pub use crate::ConnectError;
}
