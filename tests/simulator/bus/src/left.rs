//! Remaining shared memory and descriptors.

use joulebus_simulated_host as host;

use crate::CapacityError;

/// Checks that another object of shared memory can be made.
pub(crate) fn check_left() -> Result<(), CapacityError> {
    if host::memory_is_full() {
        return Err(CapacityError::Memory { needed: 1 << 16, free: 0 });
    }
    if !host::has_descriptors(host::current()) {
        return Err(CapacityError::Descriptors { needed: 80, used: 64, limit: 64 });
    }
    Ok(())
}
