//! One worker per fleet: the lock, and the file that names its holder.

use std::cell::{Cell, RefCell};
use std::io;
use std::path::{Path, PathBuf};

use joulebus_simulated_host::{self as host, memory::outside};

use crate::{Domain, WorkerLockError, clock};

/// The lock file's statement about its holder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Owner {
    pub(crate) pid: u32,
    pub(crate) since_unix_ns: u64,
    pub(crate) port_pid: u32,
}

thread_local! {
    /// The owner that the file names, and whether the lock is held.
    static FILE: Cell<Option<(Owner, bool)>> = const { Cell::new(None) };
    /// Owners that have shut down.
    static ENDED: RefCell<Vec<Owner>> = const { RefCell::new(Vec::new()) };
}

pub(crate) fn begin() {
    FILE.set(None);
    ENDED.with_borrow_mut(Vec::clear);
}

/// Holder of a worker's lock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WorkerOwner {
    pub pid: Option<u32>,
}

/// The exclusive right to be the fleet's worker.
#[derive(Debug)]
pub struct WorkerLock {
    owner: Owner,
    path: PathBuf,
}

impl WorkerLock {
    pub fn acquire(domain: &Domain) -> Result<Self, WorkerLockError> {
        host::operation();
        crate::left::check_left()?;
        let path = domain.worker_file();
        if let Some((owner, true)) = FILE.get() {
            let source = io::Error::other(format!("process {} holds it", owner.pid));
            return Err(WorkerLockError::Io { path, source });
        }
        let pid = host::current();
        let owner = Owner { pid, since_unix_ns: clock::unix_ns(), port_pid: pid };
        FILE.set(Some((owner, true)));
        Ok(Self { owner, path })
    }

    /// Holder of the lock of the domain, if any.
    pub fn owner(_domain: &Domain) -> io::Result<Option<WorkerOwner>> {
        host::operation();
        let held = FILE.get().filter(|(_, is_held)| *is_held);
        Ok(held.map(|(owner, _)| WorkerOwner { pid: Some(owner.pid) }))
    }

    /// The owner that the lock's file names, holding it or not.
    pub(crate) fn named_owner(_path: &Path) -> Option<Owner> {
        host::operation();
        FILE.get().map(|(owner, _)| owner)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for WorkerLock {
    fn drop(&mut self) {
        match FILE.get() {
            // The kernel releases the lock of a killed process; its file remains.
            Some((owner, _)) if owner == self.owner && host::is_dead() => {
                FILE.set(Some((owner, false)));
            }
            Some((owner, _)) if owner == self.owner => FILE.set(None),
            _ => {}
        }
        if !host::is_dead() {
            outside(|| ENDED.with_borrow_mut(|ended| ended.push(self.owner)));
        }
    }
}

#[derive(Debug)]
pub(crate) struct LockWatch(Owner);

impl LockWatch {
    /// The watch of process `pid`, if the file names it.
    pub(crate) fn open(pid: u32) -> Option<Self> {
        let (owner, _) = FILE.get().filter(|(owner, _)| owner.pid == pid)?;
        Some(Self(owner))
    }

    /// True once the worker has shut down.
    pub(crate) fn has_ended(&self) -> bool {
        ENDED.with_borrow(|ended| ended.contains(&self.0))
    }
}
