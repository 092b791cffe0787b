//! Errors of starting a worker.

use std::io;

use joulebus_bus::{CapacityError, DomainError, JoinError, SchedulingError, WorkerLockError};
use joulebus_models::ModelsError;
use joulebus_settings::SettingsError;

use crate::ledger_files::LedgerFileError;
use crate::tick_pool::TickPoolError;

/// Errors of starting a worker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// The config's domain is invalid.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// A model could not be loaded.
    #[error(transparent)]
    Models(#[from] ModelsError),
    /// The settings are inconsistent.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The ledger's file.
    #[error(transparent)]
    Ledger(#[from] LedgerFileError),
    /// Too little shared memory or too few descriptors.
    #[error(transparent)]
    Capacity(#[from] CapacityError),
    /// Another worker serves the fleet.
    #[error(transparent)]
    Lock(#[from] WorkerLockError),
    /// The domain could not be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Port(#[from] joulebus_bus::OpenError),
    /// The checkpointer's thread could not be started, or the boot id is unknown.
    #[error("the worker's checkpointer cannot start: {0}")]
    Checkpointer(#[from] io::Error),
    /// The system refused scheduling that the config requires.
    #[error("{0} (`worker.if_refused = \"stop\"` in the config)")]
    Scheduling(#[from] SchedulingError),
    /// The threads of a parallel tick could not be started.
    #[error(transparent)]
    Threads(#[from] TickPoolError),
}
