//! Panics of the simulated processes.

use std::cell::RefCell;

thread_local! {
    /// Location of the last panic of this thread.
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Panics of the simulated processes are findings: they are kept instead of printed.
pub fn keep_panics() {
    std::panic::set_hook(Box::new(|panic| {
        PANIC.with_borrow_mut(|kept| *kept = panic.to_string());
    }));
}

pub(crate) fn last_panic() -> String {
    PANIC.take()
}
