//! A flag that is set when its guard is dropped, for tests with scoped threads: a failed assertion
//! must end the threads that the scope waits for.

use std::sync::atomic::{AtomicBool, Ordering};

/// Sets the flag when dropped.
#[derive(Debug)]
pub struct OnDrop<'a>(pub &'a AtomicBool);

impl Drop for OnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
