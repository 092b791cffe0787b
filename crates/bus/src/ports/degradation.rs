//! Failed connections to other ports.

use std::sync::atomic::{AtomicU64, Ordering};

use iceoryx2::port::DegradationAction;

/// Counts a failed connection instead of returning an error immediately, which would leave the
/// following ports unconnected too, without a retry. The reader converts the count into an error.
pub(crate) fn count_degradation(counted: &AtomicU64) -> DegradationAction {
    counted.fetch_add(1, Ordering::Relaxed);
    DegradationAction::Ignore
}
