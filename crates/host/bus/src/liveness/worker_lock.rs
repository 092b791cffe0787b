//! One worker per fleet.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;

use crate::directory::RETRY_TIMEOUT;
use crate::os::files::{effective_uid, is_same};
use crate::os::process::lock_holders;
use crate::preflight::check_start;
use crate::{CapacityError, Domain, RootError, clock};

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
        let begin = Instant::now();
        loop {
            let error = match Self::try_acquire(domain) {
                Ok(Some(lock)) => return Ok(lock),
                // The previous owner has just removed the file, or its directory.
                Ok(None) => continue,
                Err(error) => error,
            };
            let vanished = match &error {
                WorkerLockError::Io { source, .. } => source.kind() == ErrorKind::NotFound,
                WorkerLockError::Root(error) => error.vanished(),
                _ => false,
            };
            if !vanished || begin.elapsed() > RETRY_TIMEOUT {
                if !matches!(error, WorkerLockError::AlreadyRunning { .. }) {
                    // Created before the failure.
                    Self::remove_stale(domain);
                    crate::directory::remove_root(domain);
                }
                return Err(error.or_shortage());
            }
        }
    }

    pub(crate) fn path(&self) -> PathBuf {
        self.domain.worker_file()
    }

    /// Holder of the lock of `domain`, if any.
    ///
    /// # Errors
    /// When the lock file cannot be read.
    pub fn owner(domain: &Domain) -> io::Result<Option<WorkerOwner>> {
        let mut file = match open(domain, false) {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error),
        };
        match flock(&file, FlockOperation::NonBlockingLockShared) {
            Ok(()) => {
                release(&file);
                Ok(None)
            }
            Err(Errno::WOULDBLOCK) => WorkerOwner::read(&mut file).map(Some),
            Err(error) => Err(error.into()),
        }
    }

    /// The owner that the lock file names, whether it holds the lock or not. `None` if there is no
    /// readable file. Takes no lock, so a worker that starts at this moment is not kept from it.
    pub(crate) fn named_owner(path: &Path) -> Option<Owner> {
        let file = fs::OpenOptions::new()
            .read(true)
            .custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed())
            .open(path)
            .ok()?;
        let mut text = String::new();
        file.take(MAX_BYTES).read_to_string(&mut text).ok()?;
        Owner::parse(&text)
    }

    /// Removes the file of a killed worker, unless it is held or not a lock file. A process that
    /// takes the lock at this moment detects that the file is gone and retries.
    pub(crate) fn remove_stale(domain: &Domain) {
        let path = domain.worker_file();
        if let Ok(mut file) = open(domain, false)
            && flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok()
        {
            if is_same(&file, &path).unwrap_or(false) && is_lock(&mut file).unwrap_or(false) {
                let _ = fs::remove_file(&path);
            }
            release(&file);
        }
    }

    fn try_acquire(domain: &Domain) -> Result<Option<Self>, WorkerLockError> {
        crate::directory::prepare_root(domain)?;
        let path = domain.worker_file();
        let failed = |source| WorkerLockError::Io { path: path.clone(), source };
        let mut file = match open(domain, true) {
            Ok(file) => file,
            Err(error) if is_symlink(&error) => return Err(WorkerLockError::NotALock { path }),
            Err(error) => return Err(failed(error)),
        };
        let begin = Instant::now();
        let mut looks = Looks::default();
        loop {
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => break,
                Err(Errno::INTR) => return Ok(None),
                Err(Errno::WOULDBLOCK) => {}
                Err(error) => return Err(failed(error.into())),
            }
            let (owner, is_named) = WorkerOwner::look(&mut file).map_err(failed)?;
            if !is_same(&file, &path).map_err(failed)? {
                return Ok(None);
            }
            // A prober briefly holds the lock shared, and longer where it gets no processor. A
            // shared holder is not a worker.
            if flock(&file, FlockOperation::NonBlockingLockShared).is_ok() {
                flock(&file, FlockOperation::Unlock).map_err(|error| failed(error.into()))?;
                if begin.elapsed() > RETRY_TIMEOUT {
                    return Err(WorkerLockError::Looked { path });
                }
            } else if is_named || looks.are_enough(owner) {
                return Err(WorkerLockError::AlreadyRunning {
                    fleet: domain.fleet().to_owned(),
                    owner,
                    path,
                });
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        if !is_same(&file, &path).map_err(failed)? {
            return Ok(None);
        }
        if !is_lock(&mut file).map_err(failed)? {
            return Err(WorkerLockError::NotALock { path });
        }
        let owner = Owner {
            pid: std::process::id(),
            since_unix_ns: clock::unix_ns(),
            port_pid: outermost_pid(),
        };
        file.set_len(0)
            .and_then(|()| file.seek(SeekFrom::Start(0)))
            .and_then(|_| file.write_all(owner.line().as_bytes()))
            .map_err(failed)?;
        Ok(Some(Self { file, domain: domain.clone() }))
    }
}

impl Drop for WorkerLock {
    fn drop(&mut self) {
        let path = self.domain.worker_file();
        // Only the file that we locked: it may have been removed by hand.
        if is_same(&self.file, &path).unwrap_or(false) {
            let _ = fs::remove_file(&path);
        }
        // `LockWatch` distinguishes a shutdown from a death by the empty file.
        let _ = self.file.set_len(0);
        crate::directory::remove_root(&self.domain);
    }
}

/// Unlocks before closing: a child that another thread forks has the file open until its `exec`.
fn release(file: &File) {
    let _ = flock(file, FlockOperation::Unlock);
}

/// Maximum number of looks at a lock whose holder the file does not name, and their interval.
const LOOKS: u32 = 50;
const POLLS_WHILE_SEEN: u32 = 500;
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Looks at a held lock whose file names nobody.
#[derive(Debug, Default)]
struct Looks {
    seen: u32,
    /// Since the holder was seen last: the kernel's list may lack a lock while others are released.
    unseen: u32,
}

impl Looks {
    /// Counts a look that found `owner`. True if it names the holder, or none is visible here.
    fn are_enough(&mut self, owner: WorkerOwner) -> bool {
        // A holder without a name may be removing the file of a killed worker.
        if owner.pid.is_some() {
            self.seen += 1;
            self.unseen = 0;
        } else {
            self.unseen += 1;
        }
        self.seen >= POLLS_WHILE_SEEN || self.unseen >= LOOKS
    }
}
/// A file that is longer than this is not a lock's, bytes.
pub(crate) const MAX_BYTES: u64 = 64;

/// The lock file's statement about its holder.
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

    pub(crate) fn parse(text: &str) -> Option<Self> {
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

/// The pid of this process in the outermost namespace that `/proc` shows, as in port ids.
fn outermost_pid() -> u32 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let pids = status.lines().find_map(|line| line.strip_prefix("NSpid:"));
    let outermost = pids.and_then(|pids| pids.split_ascii_whitespace().next()?.parse().ok());
    outermost.unwrap_or_else(std::process::id)
}

/// Opens or creates the lock file. Does not follow symbolic links, and does not block on a FIFO.
fn open(domain: &Domain, make: bool) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    fs::OpenOptions::new()
        .read(true)
        .write(make)
        .create(make)
        .truncate(false)
        .mode(0o600)
        .custom_flags(flags.bits().cast_signed())
        .open(domain.worker_file())
}

fn is_symlink(error: &io::Error) -> bool {
    error.raw_os_error() == Some(Errno::LOOP.raw_os_error())
}

/// True for a valid lock file: a regular file with one hard link that is empty, or contains an
/// owner's line, or zeros as after a power failure.
fn is_lock(file: &mut File) -> io::Result<bool> {
    let found = file.metadata()?;
    if !found.is_file() || found.nlink() != 1 || found.uid() != effective_uid() {
        return Ok(false);
    }
    let text = first_bytes(file)?;
    let line = text.strip_suffix(b"\n").unwrap_or(&text);
    let is_line = line.iter().all(|byte| byte.is_ascii_digit() || *byte == b' ');
    Ok(found.len() <= MAX_BYTES && (is_line || text.iter().all(|byte| *byte == 0)))
}

fn first_bytes(file: &mut File) -> io::Result<Vec<u8>> {
    let mut text = Vec::new();
    // A directory or a FIFO is not read.
    if file.metadata()?.is_file() {
        file.seek(SeekFrom::Start(0))?;
        file.take(MAX_BYTES).read_to_end(&mut text)?;
    }
    Ok(text)
}

/// Holder of a worker's lock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct WorkerOwner {
    /// Its pid. `None` if it is not visible here, as in another container.
    pub pid: Option<u32>,
    /// When it took the lock, Unix ns, if the file states it.
    pub since_unix_ns: Option<u64>,
}

impl WorkerOwner {
    /// Waits briefly, because the owner writes after locking. An owner that no look saw is hidden.
    fn read(file: &mut File) -> io::Result<Self> {
        let mut seen = None;
        for _ in 1..LOOKS {
            let (owner, is_named) = Self::look(file)?;
            if is_named {
                return Ok(owner);
            }
            seen = owner.pid.map(|_| owner).or(seen);
            std::thread::sleep(POLL_INTERVAL);
        }
        let (last, _) = Self::look(file)?;
        Ok(last.pid.map(|_| last).or(seen).unwrap_or(last))
    }

    /// The holder, and whether the file names it. The file counts only if the kernel agrees.
    fn look(file: &mut File) -> io::Result<(Self, bool)> {
        let text = String::from_utf8_lossy(&first_bytes(file)?).into_owned();
        let mut words = text.split_ascii_whitespace();
        let written = words.next().and_then(|word| word.parse().ok());
        let since_unix_ns = words.next().and_then(|word| word.parse().ok());
        let holders = lock_holders(file, written)?;
        Ok(match written.filter(|pid| holders.contains(pid)) {
            Some(pid) => {
                let pid = Some(pid);
                (Self { pid, since_unix_ns }, true)
            }
            None => {
                let (pid, since_unix_ns) = (holders.first().copied(), None);
                (Self { pid, since_unix_ns }, false)
            }
        })
    }
}

impl WorkerLockError {
    /// The numbers, if shared memory is full, or its files are.
    fn or_shortage(self) -> Self {
        let (Self::Io { source, .. } | Self::Root(RootError::Io { source, .. })) = &self else {
            return self;
        };
        match check_start() {
            Err(full) if source.kind() == ErrorKind::StorageFull => full.into(),
            _ => self,
        }
    }
}

/// Reason that a process may not be the worker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum WorkerLockError {
    /// Another worker is alive.
    #[error(
        "fleet {fleet:?} already has a worker{}, or run this one for another fleet",
        remedy(*owner, path)
    )]
    AlreadyRunning { fleet: String, owner: WorkerOwner, path: PathBuf },
    /// No worker has the lock, but a process that looked for one does not let it go.
    #[error(
        "{path:?} is held for more than {} s by a process that looks whether there is a worker: it is stopped, or \
         in a debugger. `lslocks` names it. Let it go on, or end it",
        RETRY_TIMEOUT.as_secs()
    )]
    Looked { path: PathBuf },
    /// The file is not a lock file.
    #[error(
        "{path:?} is not a lock file of joulebus: it is a link, a special file, or holds \
         something else. It is left as it is. Move it away, or set another `domain.root`"
    )]
    NotALock { path: PathBuf },
    /// Too little shared memory.
    #[error(transparent)]
    Capacity(#[from] CapacityError),
    /// The root directory is not private.
    #[error(transparent)]
    Root(#[from] RootError),
    /// The system call failed.
    #[error("cannot lock {path:?}: {source}")]
    Io { path: PathBuf, source: io::Error },
}

impl WorkerOwner {
    /// True if the holder is a link, which has the worker's place on a host without one.
    pub fn is_link(self) -> bool {
        let program = self.pid.and_then(|pid| fs::read_link(format!("/proc/{pid}/exe")).ok());
        // The program may have been replaced since: its name ends differently then.
        let name = program.as_deref().and_then(Path::file_name).unwrap_or_default();
        name.as_encoded_bytes().starts_with(b"joulebus-link")
    }
}

fn remedy(owner: WorkerOwner, path: &Path) -> String {
    match owner.pid {
        Some(pid) if owner.is_link() => format!(
            " on another host: the link here stands in for it, pid {pid}. Run the worker beside a \
             link whose file has [worker]"
        ),
        Some(pid) => format!(", pid {pid}. Stop it first (`kill {pid}`)"),
        None => format!(
            " whose process is not visible here (it holds {}. Is it in another container?). Stop \
             it first",
            path.display()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn found(pid: Option<u32>) -> WorkerOwner {
        WorkerOwner { pid, since_unix_ns: None }
    }

    #[test]
    fn a_holder_is_invisible_only_if_many_looks_in_a_row_have_not_seen_it() {
        let mut looks = Looks::default();
        // Each forty-ninth look sees it.
        for look in 1..POLLS_WHILE_SEEN * (LOOKS - 1) {
            let pid = look.is_multiple_of(LOOKS - 1).then_some(7);
            assert!(!looks.are_enough(found(pid)), "look {look}");
        }
        assert!(looks.are_enough(found(Some(7))), "seen {}", looks.seen);

        let mut looks = Looks::default();
        assert!(!looks.are_enough(found(Some(7))));
        let enough = (1..).find(|_| looks.are_enough(found(None)));
        assert_eq!(enough, Some(LOOKS));
    }
}
