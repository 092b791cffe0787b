//! Requested scheduling of the tick's threads.

/// Requested scheduling of the tick's threads. The default requests nothing.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Scheduling {
    /// CPUs, one per thread, that of the tick's own thread first. Empty: no affinity.
    pub cpus: Vec<usize>,
    /// Real-time priority (`SCHED_FIFO`), 1 to 99. 0: normal scheduling.
    pub priority: u8,
    /// True to lock all memory of the process (`mlockall`).
    pub lock_memory: bool,
    /// True if a refused request prevents the start. Otherwise it is a warning.
    pub required: bool,
}

impl Scheduling {
    /// True if nothing is requested.
    pub fn is_nothing(&self) -> bool {
        self.cpus.is_empty() && self.priority == 0 && !self.lock_memory
    }
}
