//! Members of the domain: every member holds a shared lock on one file while it is alive.
//!
//! The kernel releases the lock when the process ends for any reason. A process that gets it
//! exclusively knows that no member is alive, and may remove all files. The file is the marker of
//! the fleet's directory, and is created and removed with it.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::OpenOptionsExt;

use rustix::fs::{FlockOperation, OFlags, flock};

use crate::Domain;
use crate::liveness::worker_lock::WorkerLock;
use crate::marker::Marked;
use crate::os::files::is_same;

#[derive(Debug)]
pub(crate) struct MembersLock {
    file: File,
}

impl MembersLock {
    pub(crate) fn open(domain: &Domain) -> io::Result<Self> {
        let file = fs::OpenOptions::new()
            .read(true)
            .custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed())
            .open(domain.members_file())?;
        Ok(Self { file })
    }

    /// Takes the exclusive lock. False if another process holds it.
    pub(crate) fn try_exclusive(&self) -> io::Result<bool> {
        self.lock(FlockOperation::NonBlockingLockExclusive)
    }

    pub(crate) fn try_shared(&self) -> io::Result<bool> {
        self.lock(FlockOperation::NonBlockingLockShared)
    }

    fn lock(&self, operation: FlockOperation) -> io::Result<bool> {
        match flock(&self.file, operation) {
            Ok(()) => Ok(true),
            Err(rustix::io::Errno::WOULDBLOCK | rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    pub(crate) fn is_current(&self, domain: &Domain) -> io::Result<bool> {
        is_same(&self.file, &domain.members_file())
    }

    /// Removes the fleet's directory with this file, that of a killed worker, and the root, if they
    /// are empty. The caller holds the exclusive lock. A process that opened the file in the
    /// meantime detects that it is gone and retries.
    pub(crate) fn remove(self, domain: &Domain) {
        if self.is_current(domain).unwrap_or(false) {
            Marked::fleet(domain).remove();
            WorkerLock::remove_stale(domain);
            crate::directory::remove_root(domain);
        }
    }
}
