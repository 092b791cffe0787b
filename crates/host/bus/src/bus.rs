//! A process in a domain.

use std::fs;
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::rc::Rc;
use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::prelude::{NodeName, SignalHandlingMode};
use rustix::fs::{Mode, OFlags, fchmod};

use crate::cleanup::dead_nodes::remove_dead_nodes;
use crate::cleanup::incomplete::remove_incomplete;
use crate::cleanup::objects::{named, objects};
use crate::ipc::Ipc;
use crate::liveness::guarded::Guarded;
use crate::liveness::presence::RequiredFiles;
use crate::membership::{Membership, remove_unused};
use crate::os::files::effective_uid;
use crate::os::fork::ForkSection;
use crate::preflight::{
    PORT_BYTES, PROCESS_BYTES, check_left, check_stack, check_start, check_threads,
};
use crate::reserved::take_shortage;
use crate::{Domain, FilesRemoved, Housekeeping, JoinError, SweepReport, WorkerLock};

/// Timeout of retries of creating a node.
const NODE_TIMEOUT: Duration = Duration::from_secs(2);
const NODE_RETRY_AFTER: Duration = Duration::from_millis(10);

/// Names of the members that have places of their own in every channel: the worker with its
/// threads, recorders, and links.
pub(crate) const OWN: &[&str] =
    &["worker", "checkpointer", "queries", "alarm-log", "recorder", "link", "link-journal"];

/// Names of the members that have places of their own among those who ask the worker: operators,
/// who acknowledge alarms.
pub(crate) const OPERATORS: &[&str] = &["acknowledge", "page"];

/// Membership in a domain. Dropping it and all ports leaves the domain. The last member to leave
/// removes all its files.
///
/// Belongs to one thread. iceoryx2's own signal handling is disabled: signals are left to the
/// program.
#[derive(Debug)]
pub struct Bus {
    // Dropped in this order: need of the worker's lock, node, membership.
    lock_need: Option<RequiredFiles>,
    pub(crate) node: Guarded<Node<Ipc>>,
    pub(crate) member: Rc<Membership>,
    joined: SweepReport,
}

impl Bus {
    /// Joins `domain` as `name`, for example `worker`. First removes stale files of dead processes.
    /// If no member is alive, everything. Takes 1 ms on a tmpfs, at most 5 s.
    ///
    /// # Errors
    /// [`JoinError`] names the obstacle and the remedy.
    pub fn join(domain: &Domain, name: &str) -> Result<Self, JoinError> {
        check_stack()?;
        check_threads()?;
        let _section = ForkSection::enter();
        let _ = take_shortage();
        // An error caused by lack of memory or file descriptors does not always state it.
        Self::try_join(domain, name).map_err(|error| {
            let full = check_start().and_then(|()| check_left(PROCESS_BYTES)).err();
            let full = full.or_else(take_shortage);
            remove_unused(domain);
            match full {
                Some(full) if error.may_be_shortage() => full.into(),
                _ => error,
            }
        })
    }

    fn try_join(domain: &Domain, name: &str) -> Result<Self, JoinError> {
        let node_name = NodeName::new(name)
            .ok()
            .filter(|_| !name.is_empty())
            .ok_or_else(|| JoinError::Name { name: name.to_owned() })?;
        for warning in crate::prepare_domain(domain).unwrap_or_default() {
            tracing::warn!("{warning}");
        }
        let (member, mut joined) = Membership::join(domain)?;
        joined.incomplete += remove_incomplete(domain)?;
        remove_dead_nodes(&member.config, &mut joined);
        // Memory held by dead processes has been freed.
        check_start()?;
        let node = create_node(domain, &member.config, &node_name)?;
        make_private(domain)?;
        let monitor = named(domain, &node.id().value().to_string(), &[".node_monitor"]);
        if !joined.is_clean() {
            let report = joined;
            tracing::info!(?report, "removed stale files of dead processes");
        }
        Ok(Self {
            lock_need: None,
            node: Guarded::new(node, member.presence.need(monitor)),
            member: Rc::new(member),
            joined,
        })
    }

    /// The domain.
    pub fn domain(&self) -> &Domain {
        &self.member.domain
    }

    /// Checks that all files used by this process are still at their paths. A thread checks them
    /// four times a second. This returns its result. Ports check it too.
    ///
    /// # Errors
    /// [`FilesRemoved`] states what is missing: restart the process.
    pub fn check(&self) -> Result<(), FilesRemoved> {
        self.member.presence.check()
    }

    /// Name of the thread that checks the files and removes those of dead processes, once it has
    /// ended: because files were removed ([`Bus::check`] states it), or by a defect.
    pub fn ended_thread(&self) -> Option<&'static str> {
        self.member.cleanup.ended()
    }

    /// From now on the file of `lock` is checked as well.
    pub fn needs_lock(&mut self, lock: &WorkerLock) {
        self.lock_need = Some(self.member.presence.need([lock.path()]));
    }

    /// The cleanup when joining.
    pub const fn joined(&self) -> SweepReport {
        self.joined
    }

    /// Stale files removed since by the cleanup thread, which looks for incomplete objects four
    /// times a second and for dead nodes once a second.
    pub fn housekeeping(&self) -> Housekeeping {
        self.member.cleanup.counts()
    }
}

/// Creates the node. The node counter may be an object of length zero that a killed process left
/// (#1771, #364): members remove it 250 ms after it was made or a little later, and iceoryx2 waits
/// 300 ms for it. Not for #1650, of which [`Reserved`](crate::reserved::Reserved) knows nothing.
fn create_node(domain: &Domain, config: &Config, name: &NodeName) -> Result<Node<Ipc>, JoinError> {
    let begin = Instant::now();
    loop {
        let created = NodeBuilder::new()
            .name(name)
            .config(config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>();
        let reason = match created {
            Ok(node) => return Ok(node),
            Err(reason) => reason,
        };
        let is_full = check_left(PORT_BYTES).is_err();
        if is_full || begin.elapsed() > NODE_TIMEOUT {
            return Err(JoinError::Node { root: domain.directory(), reason: reason.to_string() });
        }
        tracing::info!(%reason, "creating a node again");
        std::thread::sleep(NODE_RETRY_AFTER);
    }
}

/// iceoryx2 makes its node counter writable by all users (#1810). Only members need access.
fn make_private(domain: &Domain) -> Result<(), JoinError> {
    for object in objects(domain)? {
        if object.mode & 0o077 != 0
            && let Err(error) = restrict(&object.path)
        {
            tracing::warn!(path = ?object.path, %error, "other users can access an object");
        }
    }
    Ok(())
}

/// Does not follow symbolic links, and does not change a file with further hard links.
fn restrict(path: &Path) -> io::Result<()> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file =
        fs::OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path)?;
    let found = file.metadata()?;
    if !found.is_file() || found.uid() != effective_uid() || found.nlink() > 1 {
        return Err(io::Error::other("it is not an object of joulebus"));
    }
    Ok(fchmod(&file, Mode::RUSR | Mode::WUSR)?)
}
