//! Membership of a process: the members' lock and the cleanup thread.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::config::Config;

use crate::cleanup::objects::objects;
use crate::cleanup::sweep::remove_all;
use crate::cleanup::thread::CleanupThread;
use crate::directory::RETRY_TIMEOUT;
use crate::iceoryx_config::{self, IceoryxConfigError};
use crate::liveness::members_lock::MembersLock;
use crate::liveness::presence::{Presence, RequiredFiles};
use crate::marker::{Marked, this_boot};
use crate::os::files::effective_uid;
use crate::{CapacityError, Domain, RootError, SweepError, SweepReport};

const RETRY_EVERY: Duration = Duration::from_millis(2);

/// Membership of a process. Ports share it, so that it outlives them.
#[derive(Debug)]
pub(crate) struct Membership {
    pub(crate) domain: Domain,
    pub(crate) config: Config,
    pub(crate) cleanup: CleanupThread,
    /// Files needed while this process is a member.
    pub(crate) presence: Arc<Presence>,
    _marker: RequiredFiles,
    lock: Option<MembersLock>,
}

impl Membership {
    /// Takes the lock, cleans up if no process is alive, writes iceoryx2's configuration and starts
    /// the cleanup thread.
    pub(crate) fn join(domain: &Domain) -> Result<(Self, SweepReport), JoinError> {
        let mut report = SweepReport::default();
        let lock = Self::lock(domain, &mut report)?;
        for object in objects(domain)? {
            if object.owner != effective_uid() {
                return Err(JoinError::ForeignObject {
                    path: object.path,
                    owner: object.owner,
                    expected: effective_uid(),
                });
            }
        }
        let config = iceoryx_config::config_for(domain)?;
        iceoryx_config::write_file(domain)?;
        let presence = Arc::new(Presence::default());
        let marker = presence.need([domain.members_file()]);
        let cleanup = CleanupThread::start(domain, &config, Arc::clone(&presence))
            .map_err(JoinError::CleanupThread)?;
        Ok((
            Self {
                domain: domain.clone(),
                config,
                cleanup,
                presence,
                _marker: marker,
                lock: Some(lock),
            },
            report,
        ))
    }

    fn lock(domain: &Domain, report: &mut SweepReport) -> Result<MembersLock, JoinError> {
        let begin = Instant::now();
        loop {
            match Self::try_lock(domain, report) {
                Ok(Some(lock)) => return Ok(lock),
                // Another process is cleaning up, or has just removed the directory.
                Ok(None) => {}
                Err(JoinError::Root(error)) if error.vanished() => {}
                Err(JoinError::Lock { source, .. }) if source.kind() == io::ErrorKind::NotFound => {
                }
                Err(error) => return Err(error),
            }
            if begin.elapsed() > RETRY_TIMEOUT {
                return Err(JoinError::Timeout {
                    path: domain.members_file(),
                    waited_s: RETRY_TIMEOUT.as_secs(),
                });
            }
            std::thread::sleep(RETRY_EVERY);
        }
    }

    fn try_lock(
        domain: &Domain,
        report: &mut SweepReport,
    ) -> Result<Option<MembersLock>, JoinError> {
        let failed = |source| JoinError::Lock { path: domain.members_file(), source };
        crate::prepare_domain(domain)?;
        let lock = MembersLock::open(domain).map_err(failed)?;
        if lock.try_exclusive().map_err(failed)? && lock.is_current(domain).map_err(failed)? {
            remove_all(domain, report)?;
            if crate::directory::check(domain)? != this_boot() {
                // Left on a disk by an earlier boot: recreated, if it contains nothing else.
                Marked::fleet(domain).remove();
            }
        }
        // Nothing has been created yet, so another process may clean up while the lock is
        // converted.
        let mine = lock.try_shared().map_err(failed)? && lock.is_current(domain).map_err(failed)?;
        Ok(mine.then_some(lock))
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.cleanup.stop();
        let Some(lock) = self.lock.take() else { return };
        // Requesting the exclusive lock releases the shared one, granted or not: of several members
        // that leave at the same time exactly the last one gets it.
        match lock.try_exclusive() {
            Ok(true) if lock.is_current(&self.domain).unwrap_or(false) => {
                let mut report = SweepReport::default();
                if let Err(error) = remove_all(&self.domain, &mut report) {
                    tracing::warn!(%error, "the last member could not clean up");
                }
                lock.remove(&self.domain);
            }
            Ok(_) => {}
            Err(error) => tracing::warn!(%error, "the members' lock could not be read"),
        }
    }
}

/// Removes the files of a process that could not join, if no member is alive.
pub(crate) fn remove_unused(domain: &Domain) {
    if crate::directory::check(domain).is_ok()
        && let Ok(lock) = MembersLock::open(domain)
        && lock.try_exclusive().unwrap_or(false)
        && lock.is_current(domain).unwrap_or(false)
        && remove_all(domain, &mut SweepReport::default()).is_ok()
    {
        lock.remove(domain);
    } else {
        crate::directory::remove_root(domain);
    }
}

impl JoinError {
    /// True if a full file system may be the cause.
    pub(crate) const fn may_be_shortage(&self) -> bool {
        matches!(
            self,
            Self::Root(RootError::Io { .. })
                | Self::Config(_)
                | Self::Sweep(_)
                | Self::Lock { .. }
                | Self::Node { .. }
        )
    }
}

/// Reason that a process could not join.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum JoinError {
    /// The root directory is not private.
    #[error(transparent)]
    Root(#[from] RootError),
    /// iceoryx2 could not be configured for the domain.
    #[error(transparent)]
    Config(#[from] IceoryxConfigError),
    /// Too little shared memory.
    #[error(transparent)]
    Capacity(#[from] CapacityError),
    /// Stale files could not be removed.
    #[error("{0}. Run `joulebus doctor --fix`")]
    Sweep(#[from] SweepError),
    /// The members' lock could not be taken.
    #[error("cannot lock {path:?}: {source}")]
    Lock { path: PathBuf, source: io::Error },
    /// Another process has held the members' lock exclusively for too long.
    #[error(
        "{path:?} has been locked for {waited_s} s by a process that cleans up. Is one stopped? \
         Run `joulebus doctor --fix`"
    )]
    Timeout { path: PathBuf, waited_s: u64 },
    /// An object with the domain's prefix belongs to another user.
    #[error(
        "{path:?} belongs to uid {owner}, expected uid {expected}. Have its owner remove it, or \
         set another `root` or `prefix`"
    )]
    ForeignObject { path: PathBuf, owner: u32, expected: u32 },
    /// The cleanup thread could not be started.
    #[error("cannot start the cleanup thread: {0}")]
    CleanupThread(io::Error),
    /// The node's name.
    #[error("node name {name:?}: allowed are 1 to 128 bytes")]
    Name { name: String },
    /// iceoryx2 could not create a node.
    #[error("iceoryx2 cannot create a node below {root:?} ({reason}). Run `joulebus doctor --fix`")]
    Node { root: PathBuf, reason: String },
}
