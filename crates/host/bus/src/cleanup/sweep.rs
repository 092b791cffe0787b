//! Removal of all stale files of a domain.

use std::fs;
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::dead_nodes::{is_any_node_alive, remove_dead_nodes};
use super::incomplete::remove_incomplete;
use super::objects::{NODES, SERVICES, is_of, is_of_node, is_of_worker, list_own, objects};
use super::report::SweepReport;
use crate::directory::RETRY_TIMEOUT;
use crate::iceoryx_config::{self, IceoryxConfigError};
use crate::liveness::members_lock::MembersLock;
use crate::os::files::effective_uid;
use crate::{Domain, RootError, WorkerLock};

/// Removes stale files of dead processes in `domain`: all files if no member is alive, otherwise
/// dead nodes and incomplete objects. For a supervisor that has waited for its children, and for
/// `doctor --fix`. The caller must not be a member itself. May be called from any thread.
///
/// # Errors
/// [`SweepError`]. Whatever could be removed has been removed.
pub fn sweep(domain: &Domain) -> Result<SweepReport, SweepError> {
    let begin = Instant::now();
    loop {
        match try_sweep(domain) {
            // The last member has just removed the directory.
            Err(error) if error.vanished() && begin.elapsed() < RETRY_TIMEOUT => {}
            result => return result,
        }
    }
}

fn try_sweep(domain: &Domain) -> Result<SweepReport, SweepError> {
    let mut report = SweepReport::default();
    if fs::symlink_metadata(domain.directory()).is_err() && objects(domain)?.is_empty() {
        WorkerLock::remove_stale(domain);
        crate::directory::remove_root(domain);
        return Ok(report);
    }
    crate::prepare_domain(domain)?;
    let lock = MembersLock::open(domain)?;
    let mut is_last = lock.try_exclusive()?;
    // As a member: nobody removes everything, and starts anew, beside this.
    if !is_last && lock.try_shared()? && lock.is_current(domain)? {
        let config = iceoryx_config::config_for(domain)?;
        report.incomplete = remove_incomplete(domain)?;
        remove_dead_nodes(&config, &mut report);
        // The members may have left meanwhile.
        is_last = lock.try_exclusive()?;
    }
    if is_last {
        if !lock.is_current(domain)? {
            return Err(io::Error::from(io::ErrorKind::NotFound).into());
        }
        remove_all(domain, &mut report)?;
        lock.remove(domain);
    }
    Ok(report)
}

/// Removes all files of the domain except the members' lock. The caller holds it exclusively, so no
/// member is alive.
///
/// A process may use iceoryx2 in this domain without being a member (its command-line tool, the
/// Python package): while such a node lives, only dead nodes are removed.
pub(crate) fn remove_all(domain: &Domain, report: &mut SweepReport) -> Result<(), SweepError> {
    crate::directory::check(domain)?;
    let config = iceoryx_config::config_for(domain)?;
    report.incomplete += remove_incomplete(domain)?;
    if is_any_node_alive(&config) {
        remove_dead_nodes(&config, report);
        return Ok(());
    }
    report.cold = true;
    for object in objects(domain)? {
        if object.owner == effective_uid() && fs::remove_file(&object.path).is_ok() {
            report.objects += 1;
            report.bytes += object.bytes;
        }
    }
    remove_contents(domain, report)
}

/// Removes the files of joulebus and iceoryx2 in the fleet's directory, identified by name. Other
/// files are kept, and so is the directory then.
fn remove_contents(domain: &Domain, report: &mut SweepReport) -> Result<(), SweepError> {
    let directory = domain.directory();
    let nodes = directory.join(NODES);
    for node in list_own(&nodes).into_iter().filter(|path| is_of_node(path)) {
        remove_files(&node, report, |path| is_of(domain, path))?;
        // Fails if it contains other files, as below.
        let _ = fs::remove_dir(&node);
    }
    for inner in [nodes, directory.join(SERVICES)] {
        remove_files(&inner, report, |path| is_of(domain, path))?;
        let _ = fs::remove_dir(&inner);
    }
    remove_files(&directory, report, |path| {
        is_of(domain, path) || iceoryx_config::is_config(domain, path) || is_of_worker(path)
    })
}

fn remove_files(
    directory: &Path,
    report: &mut SweepReport,
    is_ours: impl Fn(&Path) -> bool,
) -> Result<(), SweepError> {
    for path in list_own(directory).into_iter().filter(|path| is_ours(path)) {
        let Ok(found) = fs::symlink_metadata(&path) else {
            continue;
        };
        let kind = found.file_type();
        if found.uid() == effective_uid() && (kind.is_file() || kind.is_socket()) {
            fs::remove_file(&path).map_err(|source| SweepError::Remove { path, source })?;
            report.files += 1;
        }
    }
    Ok(())
}

/// Reason that stale files could not be removed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum SweepError {
    /// The root is not private to this user.
    #[error(transparent)]
    Root(#[from] RootError),
    /// iceoryx2 could not be configured for the domain.
    #[error(transparent)]
    Config(#[from] IceoryxConfigError),
    /// The members' lock could not be read.
    #[error("members' lock: {0}")]
    Lock(#[from] io::Error),
    /// A file could not be removed.
    #[error("cannot remove {path:?}: {source}")]
    Remove { path: PathBuf, source: io::Error },
}

impl SweepError {
    fn vanished(&self) -> bool {
        let source = match self {
            Self::Root(error) => return error.vanished(),
            Self::Lock(source) | Self::Remove { source, .. } => source,
            Self::Config(_) => return false,
        };
        source.kind() == io::ErrorKind::NotFound
    }
}
