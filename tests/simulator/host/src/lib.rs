//! The simulated host of one simulation: time, processes and disk.
//!
//! A simulation belongs to one thread, and so does its host: the shells' code is called without a
//! handle of it, as it is in production without a handle of the kernel.
//!
//! Each call of the shells that reaches the host is an [`operation`]: it takes time, and the
//! simulator may let the process die in it, which unwinds with [`Killed`]. From then on until
//! [`leave`] the process does nothing: its destructors run, and have no effect.
#![allow(missing_docs)] // Used by tests alone.
#![forbid(unsafe_code)]

mod current;
pub mod disk;
pub mod memory;
mod processes;
pub mod time;

pub use current::{FIRST_PID, current};
pub use processes::{
    Killed, USUAL_COST_NS, Work, as_thread, begin_life, below, bury, end_life, enter, fill_memory,
    has_descriptors, is_dead, kill_at_disk, kill_in, leave, life, memory_is_full, next_thread,
    number, once_in, operation, remove_threads, run_thread, sleep_until, spare_all, start_numbered,
    start_thread, take_descriptors, take_thread, take_woken, thread, wake, wake_thread,
};

/// Begins a new host: nothing runs, the disk is empty, the machine has run for `uptime_ns`.
pub fn begin(seed: u64, uptime_ns: u64) {
    processes::begin(seed);
    time::begin(uptime_ns);
    disk::begin();
}
