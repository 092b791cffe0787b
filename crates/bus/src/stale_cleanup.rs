//! What dead processes leave behind, and how it goes away.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeState};
use iceoryx2::prelude::{CallbackProgression, ipc};

use crate::config::{self, ConfigError};
use crate::domain::{check_private, effective_uid};
use crate::incomplete::{objects, remove_stillborn};
use crate::membership::MembersLock;
use crate::{Domain, RootError, WorkerLock};

/// What was removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SweepReport {
    /// Nodes of dead processes that iceoryx2 removed.
    pub dead_nodes: u64,
    /// Nodes of dead processes that could not be removed; they go with the last member.
    pub failed_nodes: u64,
    /// Objects, services and nodes that were created but never finished.
    pub incomplete: u64,
    /// Objects in shared memory removed because no member was alive.
    pub objects: u64,
    /// Bytes that they took.
    pub bytes: u64,
    /// Other files removed because no member was alive.
    pub files: u64,
    /// Whether no member was alive, so that everything of the domain was removed.
    pub cold: bool,
}

impl SweepReport {
    /// Whether nothing had been left behind.
    #[must_use]
    pub const fn is_clean(&self) -> bool {
        self.dead_nodes == 0
            && self.failed_nodes == 0
            && self.incomplete == 0
            && self.objects == 0
            && self.files == 0
    }
}

/// Removes what dead processes left in `domain`: everything when no member is alive, else their
/// nodes and unfinished objects. For a supervisor, after it has waited for its children, and for
/// `doctor --fix`. The caller must not be a member itself. May be called from any thread.
///
/// # Errors
/// [`SweepError`]; what could be removed has been.
pub fn sweep(domain: &Domain) -> Result<SweepReport, SweepError> {
    loop {
        match try_sweep(domain) {
            // The last member has just removed the directory under us.
            Err(error) if error.vanished() => {}
            result => return result,
        }
    }
}

fn try_sweep(domain: &Domain) -> Result<SweepReport, SweepError> {
    let mut report = SweepReport::default();
    if fs::symlink_metadata(domain.directory()).is_err() && objects(domain)?.is_empty() {
        WorkerLock::remove_stale(domain);
        domain.remove_root();
        return Ok(report);
    }
    domain.prepare()?;
    let lock = MembersLock::open(domain)?;
    if lock.try_exclusive()? {
        remove_all(domain, &mut report)?;
        lock.remove(domain);
    } else {
        let config = config::load(domain)?;
        report.incomplete = remove_stillborn(domain)?;
        remove_dead_nodes(config, &mut report);
    }
    Ok(report)
}

/// Lets iceoryx2 remove the nodes of dead processes. 1 to 25 ms when there is work.
pub(crate) fn remove_dead_nodes(config: &Config, report: &mut SweepReport) {
    let listed = Node::<ipc::Service>::list(config, |node| {
        if let NodeState::Dead(dead) = node {
            match dead.try_remove_stale_resources() {
                Ok(()) => report.dead_nodes += 1,
                Err(reason) => {
                    tracing::debug!(%reason, "a dead node could not be removed");
                    report.failed_nodes += 1;
                }
            }
        }
        CallbackProgression::Continue
    });
    if let Err(reason) = listed {
        tracing::debug!(%reason, "nodes could not be listed");
    }
}

/// Removes everything of the domain but the members' lock. The caller holds that exclusively, so
/// no member is alive.
///
/// Somebody may use iceoryx2 in our domain without being a member (its own command-line tool, the
/// Python package): while such a node lives only the dead ones go.
pub(crate) fn remove_all(domain: &Domain, report: &mut SweepReport) -> Result<(), SweepError> {
    check_private(&domain.directory())?;
    let config = config::wanted(domain)?;
    report.incomplete += remove_stillborn(domain)?;
    if is_anybody_alive(&config) {
        remove_dead_nodes(config::load(domain)?, report);
        return Ok(());
    }
    report.cold = true;
    for object in objects(domain)? {
        if object.owner == effective_uid() && fs::remove_file(&object.path).is_ok() {
            report.objects += 1;
            report.bytes += object.bytes;
        }
    }
    remove_contents(&domain.directory(), &domain.members_file(), report)
}

fn is_anybody_alive(config: &Config) -> bool {
    let mut alive = false;
    let listed = Node::<ipc::Service>::list(config, |node| {
        alive |= matches!(node, NodeState::Alive(_));
        CallbackProgression::Continue
    });
    alive || listed.is_err()
}

fn remove_contents(
    directory: &Path,
    keep: &Path,
    report: &mut SweepReport,
) -> Result<(), SweepError> {
    let failed = |path: &Path, source| SweepError::Remove {
        path: path.to_owned(),
        source,
    };
    let entries = fs::read_dir(directory).map_err(|source| failed(directory, source))?;
    for entry in entries {
        let path = entry.map_err(|source| failed(directory, source))?.path();
        if path == keep {
            continue;
        }
        let kind = fs::symlink_metadata(&path).map_err(|source| failed(&path, source))?;
        if kind.is_dir() {
            remove_contents(&path, keep, report)?;
            fs::remove_dir(&path).map_err(|source| failed(&path, source))?;
        } else {
            fs::remove_file(&path).map_err(|source| failed(&path, source))?;
            report.files += u64::from(kind.is_file() || kind.file_type().is_socket());
        }
    }
    Ok(())
}

/// Whether `file` is still what lies at `path`.
pub(crate) fn is_same(file: &File, path: &Path) -> io::Result<bool> {
    let held = file.metadata()?;
    match fs::symlink_metadata(path) {
        Ok(there) => Ok(held.ino() == there.ino() && held.dev() == there.dev()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

/// Why leftovers could not be removed.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The root is not ours to clean.
    #[error(transparent)]
    Root(#[from] RootError),
    /// iceoryx2 could not be set to the domain.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The members' lock could not be read.
    #[error("members' lock: {0}")]
    Lock(#[from] io::Error),
    /// A file could not be removed.
    #[error("cannot remove {path:?}: {source}")]
    Remove {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl SweepError {
    fn vanished(&self) -> bool {
        let source = match self {
            Self::Root(error) => return error.vanished(),
            Self::Config(ConfigError::Write { source, .. })
            | Self::Lock(source)
            | Self::Remove { source, .. } => source,
            Self::Config(_) => return false,
        };
        source.kind() == io::ErrorKind::NotFound
    }
}
