//! The process that runs.

use std::cell::Cell;

thread_local! {
    static CURRENT: Cell<u32> = const { Cell::new(0) };
}

/// Pids of processes that come and go begin here.
pub const FIRST_PID: u32 = 100;

/// The process that runs now; 0 for the simulator itself.
pub fn current() -> u32 {
    CURRENT.get()
}

pub(crate) fn set_current(pid: u32) {
    CURRENT.set(pid);
}
