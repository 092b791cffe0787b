//! Connections to other ports that fail.

use std::sync::atomic::{AtomicU64, Ordering};

use iceoryx2::port::DegradationAction;

/// Counts instead of failing at once: failing would leave the ports after this one unconnected
/// too, and nothing would try them again. The reader turns the count into an error.
pub(crate) fn count_degradation(counted: &AtomicU64) -> DegradationAction {
    counted.fetch_add(1, Ordering::Relaxed);
    DegradationAction::Ignore
}
