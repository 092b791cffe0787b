//! A process in the domain.

use std::cell::Cell;

use joulebus_simulated_host as host;

use crate::left::check_left;
use crate::{Domain, FilesRemoved, JoinError, WorkerLock};

thread_local! {
    /// Increases whenever the files of all members are removed.
    static GENERATION: Cell<u64> = const { Cell::new(0) };
}

/// Removes the files that the members have in shared memory.
pub fn remove_files() {
    GENERATION.set(GENERATION.get() + 1);
    crate::liveness::worker_lock::begin();
}

/// Membership in a domain.
#[derive(Debug, Clone)]
pub struct Bus {
    pub(crate) domain: Domain,
    pub(crate) pid: u32,
    generation: u64,
}

impl Bus {
    /// Joins `domain`.
    pub fn join(domain: &Domain, _name: &str) -> Result<Self, JoinError> {
        host::operation();
        check_left()?;
        Ok(Self { domain: domain.clone(), pid: host::current(), generation: GENERATION.get() })
    }

    /// Checks that the files of this process are still there.
    pub fn check(&self) -> Result<(), FilesRemoved> {
        if self.generation == GENERATION.get() {
            return Ok(());
        }
        Err(FilesRemoved { path: self.domain.worker_file() })
    }

    /// No thread cleans up.
    pub const fn ended_thread(&self) -> Option<&'static str> {
        None
    }

    /// The file of `lock` is removed with the others.
    pub fn needs_lock(&mut self, lock: &WorkerLock) {
        let _ = lock.path();
    }
}
