//! Connections to other ports that fail.

use std::sync::atomic::{AtomicU64, Ordering};

use iceoryx2::port::DegradationAction;

/// Counts a failed connection instead of failing at once: that would leave the ports after this one
/// unconnected too, without a retry. The reader turns the count into an error.
pub(crate) fn count_degradation(counted: &AtomicU64) -> DegradationAction {
    counted.fetch_add(1, Ordering::Relaxed);
    DegradationAction::Ignore
}
