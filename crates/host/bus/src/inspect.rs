//! The state of a domain, for `joulebus doctor`.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

use iceoryx2::node::{Node, NodeState, NodeView};
use iceoryx2::prelude::CallbackProgression;

use crate::adopt::made_again;
use crate::cleanup::incomplete::incomplete_objects;
use crate::cleanup::objects::objects;
use crate::iceoryx_config::{self, IceoryxConfigError};
use crate::ipc::Ipc;
use crate::os::files::{effective_uid, filesystem, is_memory};
use crate::os::fork::ForkSection;
use crate::preflight::{CapacityError, measure};
use crate::private::check_private;
use crate::{CapacityReport, Domain, RootError, WorkerLock, WorkerOwner};

/// The state of a domain. Reading it has no side effects.
#[derive(Debug)]
#[non_exhaustive]
pub struct Inspection {
    /// The root directory, if it exists.
    pub root: Option<RootInfo>,
    /// Reason that the root, or the fleet's directory in it, cannot be used, if it cannot.
    pub root_error: Option<RootError>,
    /// Nodes known to iceoryx2.
    pub nodes: Vec<NodeInfo>,
    /// Holder of the worker's lock, if a worker runs.
    pub worker: Option<WorkerOwner>,
    /// Incomplete objects on which a process may be blocked. Those that a process has open were
    /// given 2.5 s.
    pub incomplete: Vec<PathBuf>,
    /// Objects with our prefix that belong to another user.
    pub foreign: Vec<PathBuf>,
    /// Objects of the domain in shared memory.
    pub objects: u64,
    /// Total size, bytes. Only written pages take memory.
    pub object_bytes: u64,
    /// Shared memory and file descriptors of the host and this process.
    pub capacity: CapacityReport,
}

/// A process's node.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct NodeInfo {
    /// Its name. Empty when its details are missing.
    pub name: String,
    /// Its process.
    pub pid: Option<u32>,
    /// Its program. Empty when its details are missing.
    pub executable: String,
    /// True if the process is alive. `None` when unknown.
    pub alive: Option<bool>,
}

/// The root directory.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct RootInfo {
    /// Its path.
    pub path: PathBuf,
    /// Owner's uid.
    pub owner: u32,
    /// The required uid: ours.
    pub expected_owner: u32,
    /// Permission bits. 0700 is expected.
    pub mode: u32,
    /// The filesystem's magic number.
    pub filesystem: u64,
    /// True if it is on a tmpfs, as recommended.
    pub in_memory: bool,
}

/// Reads the state of a domain without joining it. May be called from any thread. Waits up to 2.5 s
/// while a process makes an object.
///
/// # Errors
/// [`InspectError`] if a system call fails. Defects of the domain itself are in the result.
pub fn inspect(domain: &Domain) -> Result<Inspection, InspectError> {
    let root = root_info(domain)?;
    let root_error = root.as_ref().and_then(|_| directory_error(domain));
    let objects = objects(domain)?;
    let (mine, others): (Vec<_>, Vec<_>) =
        objects.into_iter().partition(|object| object.owner == effective_uid());
    Ok(Inspection {
        // Files of other users are not read.
        nodes: if root_error.is_none() { list_nodes(domain)? } else { Vec::new() },
        worker: WorkerLock::owner(domain).unwrap_or_default(),
        incomplete: incomplete_objects(domain)?,
        foreign: others.into_iter().map(|object| object.path).collect(),
        objects: mine.len() as u64,
        object_bytes: mine.iter().map(|object| object.bytes).sum(),
        capacity: measure()?,
        root,
        root_error,
    })
}

/// Reason that an existing directory cannot be used.
fn directory_error(domain: &Domain) -> Option<RootError> {
    check_private(domain.root())
        .and_then(|()| crate::directory::check(domain).map(drop))
        .err()
        // The fleet's directory is created when a process joins, and marked if iceoryx2 made it.
        .filter(|error| !error.vanished() && made_again(domain).is_empty())
}

fn root_info(domain: &Domain) -> Result<Option<RootInfo>, InspectError> {
    let path = domain.root();
    let metadata = match fs::symlink_metadata(path) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(RootError::io(path, error).into()),
    };
    let filesystem = filesystem(path).map_err(|error| RootError::io(path, error))?;
    Ok(Some(RootInfo {
        path: path.to_owned(),
        owner: metadata.uid(),
        expected_owner: effective_uid(),
        mode: metadata.mode() & 0o7777,
        filesystem,
        in_memory: is_memory(filesystem),
    }))
}

/// The nodes of a domain, without joining it. May be called from any thread.
///
/// # Errors
/// [`InspectError`] if the directory cannot be used, or a system call fails.
pub fn nodes(domain: &Domain) -> Result<Vec<NodeInfo>, InspectError> {
    match directory_error(domain) {
        Some(error) => Err(error.into()),
        None => list_nodes(domain),
    }
}

fn list_nodes(domain: &Domain) -> Result<Vec<NodeInfo>, InspectError> {
    let config = iceoryx_config::config_for(domain)?;
    let mut found = Vec::new();
    let _section = ForkSection::enter();
    Node::<Ipc>::list(&config, |node| {
        let (details, alive) = match &node {
            NodeState::Alive(view) => (view.details().as_ref(), Some(true)),
            NodeState::Dead(view) => (view.details().as_ref(), Some(false)),
            NodeState::Inaccessible(_) | NodeState::Undefined(_) => (None, None),
        };
        found.push(NodeInfo {
            name: details.map(|node| node.name().to_string()).unwrap_or_default(),
            pid: details.and_then(|node| u32::try_from(node.process_id().value()).ok()),
            executable: details.map(|node| node.executable().to_string()).unwrap_or_default(),
            alive,
        });
        CallbackProgression::Continue
    })
    .map_err(|reason| InspectError::Nodes { reason: reason.to_string() })?;
    Ok(found)
}

/// Reason that the state of a domain could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum InspectError {
    /// A directory could not be read.
    #[error(transparent)]
    Root(#[from] RootError),
    /// iceoryx2 rejects the domain's names.
    #[error(transparent)]
    Config(#[from] IceoryxConfigError),
    /// Free shared memory or file descriptors could not be read.
    #[error(transparent)]
    Capacity(#[from] CapacityError),
    /// iceoryx2 could not list its nodes.
    #[error("cannot list nodes: {reason}")]
    Nodes { reason: String },
}
