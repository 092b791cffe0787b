//! Shared memory as a whole.

use crate::liveness::worker_lock;
use crate::{query, queues};

/// Begins with empty shared memory, after a start of the machine.
pub fn begin() {
    queues::begin();
    worker_lock::begin();
    query::begin();
}

/// Removes the ports of a process that was killed, as the cleanup does.
pub fn remove_process(pid: u32) {
    query::remove_process(pid);
    queues::remove_process(pid);
}

/// Number of open ports of a process, without those for questions.
pub fn ports_of(pid: u32) -> usize {
    queues::ports(|of| of == pid)
}

/// Number of open ports of all services.
pub fn size() -> usize {
    queues::ports(|_| true) + query::size()
}
