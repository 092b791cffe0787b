//! A process in the domain.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use joulebus_simulated_host as host;

use crate::{CapacityError, DomainError, FilesRemoved, JoinError, WorkerLock};

/// The location of a fleet's shared memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    fleet: String,
    root: PathBuf,
}

impl Domain {
    /// A domain, checked as the real one.
    ///
    /// # Errors
    /// As of `joulebus-bus`.
    pub fn new(fleet: &str, root: &Path, prefix: &str) -> Result<Self, DomainError> {
        joulebus_bus::Domain::new(fleet, root, prefix)?;
        Ok(Self {
            fleet: fleet.to_owned(),
            root: root.to_owned(),
        })
    }

    pub(crate) fn worker_file(&self) -> PathBuf {
        self.root.join(format!("{}.worker", self.fleet))
    }
}

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
    ///
    /// # Errors
    /// Shared memory is full, or there are no descriptors.
    pub fn join(domain: &Domain, _name: &str) -> Result<Self, JoinError> {
        host::operation();
        check_left()?;
        Ok(Self {
            domain: domain.clone(),
            pid: host::current(),
            generation: GENERATION.get(),
        })
    }

    /// Checks that the files of this process are still there.
    ///
    /// # Errors
    /// They are not.
    pub fn check(&self) -> Result<(), FilesRemoved> {
        if self.generation == GENERATION.get() {
            return Ok(());
        }
        Err(FilesRemoved {
            path: self.domain.worker_file(),
        })
    }

    /// The file of `lock` is removed with the others.
    pub fn needs_lock(&mut self, lock: &WorkerLock) {
        let _ = lock.path();
    }
}

/// Whether another object of shared memory can be made.
pub(crate) fn check_left() -> Result<(), CapacityError> {
    if host::memory_is_full() {
        return Err(CapacityError::Memory {
            needed: 1 << 16,
            free: 0,
        });
    }
    if !host::has_descriptors(host::current()) {
        return Err(CapacityError::Descriptors {
            needed: 80,
            used: 64,
            limit: 64,
        });
    }
    Ok(())
}
