//! Watches a worker by its open lock file, for readers that listen to no events.

use std::fs::{self, File};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::{FlockOperation, OFlags, flock};

use crate::liveness::worker_lock::{MAX_BYTES, Owner};

/// The lock file of one run of a worker. A worker that shuts down removes the file and then empties
/// it. That of a killed one keeps its contents until another worker writes its own into it.
#[derive(Debug)]
pub(crate) struct LockWatch {
    file: File,
    owner: Owner,
}

impl LockWatch {
    /// Opens the file at `path`, if it names `pid`.
    pub(crate) fn open(path: &Path, pid: u32) -> Option<Self> {
        let file = fs::OpenOptions::new()
            .read(true)
            .custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed())
            .open(path)
            .ok()?;
        let owner = named(&file).filter(|owner| owner.pid == pid)?;
        Some(Self { file, owner })
    }

    /// True once the worker has shut down.
    pub(crate) fn has_ended(&self) -> bool {
        let found = self.file.metadata();
        found.is_ok_and(|found| found.nlink() == 0 && found.len() == 0)
    }

    /// True if the lock is free, or another worker's. For processes that cannot be watched. Takes
    /// the lock for a moment, for which a worker that starts waits.
    pub(crate) fn is_left(&self) -> bool {
        if flock(&self.file, FlockOperation::NonBlockingLockShared).is_ok() {
            let _ = flock(&self.file, FlockOperation::Unlock);
            return true;
        }
        named(&self.file).is_some_and(|owner| owner != self.owner)
    }
}

fn named(file: &File) -> Option<Owner> {
    let mut text = [0; MAX_BYTES as usize];
    let len = file.read_at(&mut text, 0).ok()?;
    Owner::parse(std::str::from_utf8(&text[..len]).ok()?)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::{Domain, WorkerLock};

    fn domain(name: &str) -> (Domain, PathBuf) {
        let root = PathBuf::from(format!("/dev/shm/jblw-{name}-{}", std::process::id()));
        let domain = Domain::new("lab", &root, "jblw_").unwrap();
        let path = domain.worker_file();
        (domain, path)
    }

    #[test]
    fn a_shutdown_is_distinguished_from_a_death_whoever_removes_the_file() {
        let (domain, path) = domain("end");
        let lock = WorkerLock::acquire(&domain).unwrap();
        assert!(LockWatch::open(&path, 1).is_none(), "of another process");
        let watch = LockWatch::open(&path, std::process::id()).unwrap();
        assert!(!watch.has_ended() && !watch.is_left());
        // By hand, while it is held.
        let kept = path.with_extension("kept");
        fs::hard_link(&path, &kept).unwrap();
        fs::remove_file(&path).unwrap();
        fs::remove_file(&kept).unwrap();
        assert!(!watch.has_ended() && !watch.is_left());
        drop(lock);
        assert!(watch.has_ended() && watch.is_left());
    }

    #[test]
    fn a_successor_in_the_same_file_shows_that_the_watched_worker_was_killed() {
        let (domain, path) = domain("next");
        crate::directory::prepare_root(&domain).unwrap();
        // As a killed worker leaves it.
        fs::write(&path, "77 5 77\n").unwrap();
        let watch = LockWatch::open(&path, 77).unwrap();
        assert!(watch.is_left() && !watch.has_ended());
        let lock = WorkerLock::acquire(&domain).unwrap();
        assert!(watch.is_left() && !watch.has_ended());
        drop(lock);
    }
}
