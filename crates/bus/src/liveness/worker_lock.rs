//! One worker per fleet.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};

use crate::os::files::is_same;
use crate::{Domain, RootError, clock};

/// The exclusive right to be a fleet's worker, held while this value lives. The kernel releases the
/// lock when the process ends for any reason.
#[derive(Debug)]
pub struct WorkerLock {
    file: File,
    domain: Domain,
}

impl WorkerLock {
    /// Takes the lock.
    ///
    /// # Errors
    /// [`WorkerLockError::AlreadyRunning`] with the owner's pid if another worker is alive.
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

    /// Whom the lock's file names, held or not; `None` if there is no file, or none that can be read. Takes
    /// no lock: a worker that starts at this moment is not kept from it.
    pub(crate) fn named_owner(path: &Path) -> Option<Owner> {
        let file = fs::OpenOptions::new()
            .read(true)
            .custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed())
            .open(path)
            .ok()?;
        let mut text = String::new();
        file.take(LONGEST_BYTES).read_to_string(&mut text).ok()?;
        Owner::parse(&text)
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
        let owner = Owner {
            pid: std::process::id(),
            since_unix_ns: clock::unix_ns(),
            port_pid: outermost_pid(),
        };
        file.set_len(0)
            .and_then(|()| file.write_all(owner.line().as_bytes()))
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

/// A file that is longer than this is not a lock's, bytes.
const LONGEST_BYTES: u64 = 64;

/// What the holder of the lock has written into its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Owner {
    pub(crate) pid: u32,
    /// When it took the lock, Unix ns: a label that no two holders share.
    pub(crate) since_unix_ns: u64,
    /// Its pid as iceoryx2 writes it into the ids of ports.
    pub(crate) port_pid: u32,
}

impl Owner {
    fn line(self) -> String {
        format!("{} {} {}\n", self.pid, self.since_unix_ns, self.port_pid)
    }

    fn parse(text: &str) -> Option<Self> {
        let mut words = text.strip_suffix('\n')?.split_ascii_whitespace();
        let pid = words.next()?.parse().ok()?;
        Some(Self {
            pid,
            since_unix_ns: words.next()?.parse().ok()?,
            port_pid: match words.next() {
                Some(word) => word.parse().ok()?,
                None => pid,
            },
        })
    }
}

/// The pid of this process in the outermost namespace that `/proc` shows, as iceoryx2 determines it.
fn outermost_pid() -> u32 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let pids = status.lines().find_map(|line| line.strip_prefix("NSpid:"));
    let outermost = pids.and_then(|pids| pids.split_ascii_whitespace().next()?.parse().ok());
    outermost.unwrap_or_else(std::process::id)
}

/// Pid and start of the owner. It writes them right after locking; until then the file may still name
/// a killed one, so this waits briefly.
fn read(file: &mut File) -> io::Result<(u32, u64)> {
    let mut found = (0, 0);
    for _ in 0..50 {
        let mut text = String::new();
        file.seek(SeekFrom::Start(0))?;
        file.read_to_string(&mut text)?;
        if let Some(owner) = Owner::parse(&text) {
            found = (owner.pid, owner.since_unix_ns);
            if is_alive(owner.pid) {
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

/// Reason that a process may not be the worker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WorkerLockError {
    /// Another worker is alive.
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
    /// The system call failed.
    #[error("cannot lock {path:?}: {source}")]
    Io {
        /// The lock file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
}
