//! A flag that is set when its guard is dropped, for tests with scoped threads: a failed assertion
//! must end the threads that the scope waits for. Include it with `#[path]`.

use std::sync::atomic::{AtomicBool, Ordering};

/// Sets the flag when dropped.
pub(crate) struct OnDrop<'a>(pub(crate) &'a AtomicBool);

impl Drop for OnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
