//! Selection of frames: the newest of this schema version, unless it was returned before.

use joulebus_bus::{ReceiveError, WaitError};
use joulebus_wire::SCHEMA_VERSION;

use crate::tracker::RunOrder;

/// True if a frame is of our version and later than the one at `at`, which is then advanced.
pub(crate) fn newer(
    schema: u32,
    order: RunOrder,
    at: &mut Option<RunOrder>,
    foreign: &mut Option<u32>,
) -> bool {
    if schema != SCHEMA_VERSION {
        *foreign = Some(schema);
        return false;
    }
    let newer = Some(order) > *at;
    if newer {
        *at = Some(order);
    }
    newer
}

/// Reports frames of another version, unless a usable one was found.
pub(crate) const fn check_schema(found: bool, schema: Option<u32>) -> Result<(), ReadError> {
    match schema {
        Some(schema) if !found => Err(ReadError::Schema { found: schema }),
        _ => Ok(()),
    }
}

/// Errors of reading.
///
/// ```no_run
/// # use joulebus_consumer::{ReadError, Subscriber};
/// # fn example(subscriber: &mut Subscriber) {
/// match subscriber.latest() {
///     Err(ReadError::Schema { found }) => eprintln!("the worker has schema {found}"),
///     // It names the remedy. The next call may succeed.
///     Err(error) => eprintln!("{error}"),
///     Ok(_) => {}
/// }
/// # }
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ReadError {
    /// The worker has another schema version.
    #[error(
        "a frame of schema version {found}, allowed is {SCHEMA_VERSION}. Use the same release of \
         joulebus for the worker and its planners"
    )]
    Schema { found: u32 },
    /// The frames could not be received.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The wait failed.
    #[error(transparent)]
    Wait(#[from] WaitError),
}
