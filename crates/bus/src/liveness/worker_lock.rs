//! One worker per fleet.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::time::Duration;

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};

use crate::os::files::is_same;
use crate::{Domain, RootError, clock};

/// The right to be a fleet's worker, held while this value lives. The kernel releases the lock when the
/// process ends, however it ends.
#[derive(Debug)]
pub struct WorkerLock {
    file: File,
    domain: Domain,
}

impl WorkerLock {
    /// Takes the lock.
    ///
    /// # Errors
    /// [`WorkerLockError::AlreadyRunning`] with the owner's pid while another worker lives.
    pub fn acquire(domain: &Domain) -> Result<Self, WorkerLockError> {
        loop {
            match Self::try_acquire(domain) {
                Ok(Some(lock)) => return Ok(lock),
                // The previous owner has just removed the file, or its directory.
                Ok(None) => {}
                Err(WorkerLockError::Io { source, .. })
                    if source.kind() == io::ErrorKind::NotFound => {}
                Err(WorkerLockError::Root(error)) if error.vanished() => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// The pid of the worker that holds the lock of `domain`, if any does.
    ///
    /// # Errors
    /// When the lock file cannot be read.
    pub fn owner(domain: &Domain) -> io::Result<Option<u32>> {
        let path = domain.worker_file();
        let mut file = match fs::OpenOptions::new().read(true).open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error),
        };
        match flock(&file, FlockOperation::NonBlockingLockShared) {
            Ok(()) => Ok(None),
            Err(Errno::WOULDBLOCK) => Ok(Some(read(&mut file)?.0)),
            Err(error) => Err(error.into()),
        }
    }

    /// Removes the file of a killed worker, but not one that is held. A process that takes the lock at
    /// this moment sees that the file is gone and retries.
    pub(crate) fn remove_stale(domain: &Domain) {
        let path = domain.worker_file();
        if let Ok(file) = fs::OpenOptions::new().read(true).open(&path)
            && flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok()
            && is_same(&file, &path).unwrap_or(false)
        {
            let _ = fs::remove_file(&path);
        }
    }

    fn try_acquire(domain: &Domain) -> Result<Option<Self>, WorkerLockError> {
        domain.prepare_root()?;
        let path = domain.worker_file();
        let failed = |source| WorkerLockError::Io {
            path: path.clone(),
            source,
        };
        let mut file = fs::OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .custom_flags(OFlags::NOFOLLOW.bits().cast_signed())
            .open(&path)
            .map_err(failed)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {}
            Err(Errno::INTR) => return Ok(None),
            Err(Errno::WOULDBLOCK) => {
                let (pid, since_unix_ns) = read(&mut file).map_err(failed)?;
                if !is_same(&file, &path).map_err(failed)? {
                    return Ok(None);
                }
                return Err(WorkerLockError::AlreadyRunning {
                    fleet: domain.fleet().to_owned(),
                    pid,
                    since_unix_ns,
                });
            }
            Err(error) => return Err(failed(error.into())),
        }
        if !is_same(&file, &path).map_err(failed)? {
            return Ok(None);
        }
        let owner = format!("{} {}\n", std::process::id(), clock::unix_ns());
        file.set_len(0)
            .and_then(|()| file.write_all(owner.as_bytes()))
            .map_err(failed)?;
        Ok(Some(Self {
            file,
            domain: domain.clone(),
        }))
    }
}

impl Drop for WorkerLock {
    fn drop(&mut self) {
        let path = self.domain.worker_file();
        // Only the file that we locked: somebody may have removed it by hand.
        if is_same(&self.file, &path).unwrap_or(false) {
            let _ = fs::remove_file(&path);
        }
        self.domain.remove_root();
    }
}

/// Pid and start of the owner. It writes them right after locking; until then the file may still name
/// a killed one, so this waits briefly.
fn read(file: &mut File) -> io::Result<(u32, u64)> {
    let mut found = (0, 0);
    for _ in 0..50 {
        let mut text = String::new();
        file.seek(SeekFrom::Start(0))?;
        file.read_to_string(&mut text)?;
        let mut words = text.split_ascii_whitespace();
        if text.ends_with('\n')
            && let Some(pid) = words.next().and_then(|word| word.parse().ok())
            && let Some(since) = words.next().and_then(|word| word.parse().ok())
        {
            found = (pid, since);
            if is_alive(pid) {
                break;
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Ok(found)
}

/// Whether there is such a process here; one of another container is not seen.
fn is_alive(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| !matches!(test_kill_process(pid), Err(Errno::SRCH)))
}

/// Why a process may not be the worker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WorkerLockError {
    /// There is one.
    #[error(
        "fleet {fleet:?} already has a worker, pid {pid}; stop it first (`kill {pid}`), or run \
         this one for another fleet"
    )]
    AlreadyRunning {
        /// Name of the fleet.
        fleet: String,
        /// Its process id; 0 if it has not said.
        pid: u32,
        /// When it took the lock, Unix ns.
        since_unix_ns: u64,
    },
    /// The root directory is not private.
    #[error(transparent)]
    Root(#[from] RootError),
    /// The system refused.
    #[error("cannot lock {path:?}: {source}")]
    Io {
        /// The lock file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}
