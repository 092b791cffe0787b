//! A process in a domain.

use std::rc::Rc;
use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::prelude::{NodeName, SignalHandlingMode, ipc};
use rustix::fs::Mode;

use crate::cleanup::dead_nodes::remove_dead_nodes;
use crate::cleanup::incomplete::remove_incomplete;
use crate::cleanup::objects::objects;
use crate::membership::Membership;
use crate::{Domain, Housekeeping, JoinError, SweepReport};

/// Timeout of retries of creating a node.
const NODE_LIMIT: Duration = Duration::from_secs(2);
const NODE_AGAIN_AFTER: Duration = Duration::from_millis(10);

/// Membership in a domain. Dropping it and all ports leaves the domain; the last member to leave
/// removes all its files.
///
/// Belongs to one thread. iceoryx2's own signal handling is disabled: signals are left to the
/// program.
#[derive(Debug)]
pub struct Bus {
    pub(crate) node: Node<ipc::Service>,
    pub(crate) member: Rc<Membership>,
    joined: SweepReport,
}

impl Bus {
    /// Joins `domain` as `name`, for example `worker`. First removes stale files of dead processes;
    /// if no member is alive, everything. Takes 1 ms on a tmpfs, at most 5 s.
    ///
    /// # Errors
    /// [`JoinError`] names the obstacle and the remedy.
    pub fn join(domain: &Domain, name: &str) -> Result<Self, JoinError> {
        let node_name = NodeName::new(name)
            .ok()
            .filter(|_| !name.is_empty())
            .ok_or_else(|| JoinError::Name {
                name: name.to_owned(),
            })?;
        for warning in domain.prepare().unwrap_or_default() {
            tracing::warn!("{warning}");
        }
        let (member, mut joined) = Membership::join(domain)?;
        let config = Config::global_config();
        joined.incomplete += remove_incomplete(domain)?;
        remove_dead_nodes(config, &mut joined);
        let node = create_node(domain, &node_name)?;
        make_private(domain)?;
        if !joined.is_clean() {
            let report = joined;
            tracing::info!(?report, "removed stale files of dead processes");
        }
        Ok(Self {
            node,
            member: Rc::new(member),
            joined,
        })
    }

    /// The domain.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.member.domain
    }

    /// What joining removed.
    #[must_use]
    pub const fn joined(&self) -> SweepReport {
        self.joined
    }

    /// Stale files removed since by the cleanup thread, which looks for incomplete objects four
    /// times a second and for dead nodes once a second.
    #[must_use]
    pub fn housekeeping(&self) -> Housekeeping {
        self.member.cleanup.counts()
    }
}

/// Creates the node. About once in 300 starts next to a process killed at its own start, while
/// members clean up, iceoryx2 answers `InternalError`: that passes.
fn create_node(domain: &Domain, name: &NodeName) -> Result<Node<ipc::Service>, JoinError> {
    let begin = Instant::now();
    loop {
        let created = NodeBuilder::new()
            .name(name)
            .config(Config::global_config())
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>();
        let reason = match created {
            Ok(node) => return Ok(node),
            Err(reason) => reason,
        };
        if begin.elapsed() > NODE_LIMIT {
            return Err(JoinError::Node {
                root: domain.directory(),
                reason: reason.to_string(),
            });
        }
        tracing::info!(%reason, "creating a node again");
        std::thread::sleep(NODE_AGAIN_AFTER);
    }
}

/// iceoryx2 makes its node counter writable by all users; only members need access.
fn make_private(domain: &Domain) -> Result<(), JoinError> {
    for object in objects(domain)? {
        if object.mode & 0o077 != 0
            && let Err(error) = rustix::fs::chmod(&object.path, Mode::RUSR | Mode::WUSR)
        {
            tracing::warn!(path = ?object.path, %error, "other users can access an object");
        }
    }
    Ok(())
}
