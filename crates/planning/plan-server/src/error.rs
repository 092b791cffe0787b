//! Errors of the ports.

use joulebus_bus::{DomainError, JoinError, OpenError, ReceiveError, SendError, WaitError};
use joulebus_planner::ConnectError;

/// Errors of answering. The ports are opened again.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ServerError {
    #[error(transparent)]
    Domain(#[from] DomainError),
    #[error(transparent)]
    Join(#[from] JoinError),
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error(transparent)]
    Connect(#[from] ConnectError),
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    #[error(transparent)]
    Send(#[from] SendError),
    #[error(transparent)]
    Wait(#[from] WaitError),
}
