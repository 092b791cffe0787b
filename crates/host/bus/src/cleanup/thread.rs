//! The cleanup thread of each member: removes stale files of dead processes while members are
//! alive, and checks that the member's own files exist.

use std::fs::File;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use iceoryx2::config::Config;

use super::dead_nodes::remove_dead_nodes;
use super::incomplete::Search;
use super::report::SweepReport;
use crate::Domain;
use crate::liveness::presence::{FilesRemoved, Presence};
use crate::marker::{Marked, open_directory};
use crate::os::background::{Background, Steps};

/// A member may be blocked on an incomplete object. Most rounds read no directory ([`Search`]).
const INCOMPLETE_EVERY: Duration = Duration::from_millis(250);
/// Number of rounds between searches for dead nodes: once a second.
const DEAD_NODES_EVERY: u64 = 4;

const NAME: &str = "joulebus-clean";

/// Stale files that this process has removed since it joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Housekeeping {
    /// Nodes of dead processes removed.
    pub dead_nodes: u64,
    /// Failed attempts to remove dead nodes.
    pub failed_nodes: u64,
    /// Incomplete objects, services and nodes removed.
    pub incomplete: u64,
}

#[derive(Debug, Default)]
struct Counts {
    dead_nodes: AtomicU64,
    failed_nodes: AtomicU64,
    incomplete: AtomicU64,
}

#[derive(Debug)]
pub(crate) struct CleanupThread {
    counts: Arc<Counts>,
    thread: Background,
}

impl CleanupThread {
    pub(crate) fn start(
        domain: &Domain,
        config: &Config,
        presence: Arc<Presence>,
    ) -> io::Result<Self> {
        let counts = Arc::new(Counts::default());
        let rounds = Rounds {
            domain: domain.clone(),
            directory: open_directory(&domain.directory())?,
            config: config.clone(),
            presence,
            counts: Arc::clone(&counts),
            search: Search::default(),
            round: 0,
        };
        let thread = Background::start(NAME, || io::Result::Ok(rounds))?;
        Ok(Self { counts, thread })
    }

    pub(crate) fn counts(&self) -> Housekeeping {
        let counts = &self.counts;
        Housekeeping {
            dead_nodes: counts.dead_nodes.load(Ordering::Relaxed),
            failed_nodes: counts.failed_nodes.load(Ordering::Relaxed),
            incomplete: counts.incomplete.load(Ordering::Relaxed),
        }
    }

    /// The thread's name, once nothing is cleaned up any more.
    pub(crate) fn ended(&self) -> Option<&'static str> {
        self.thread.has_ended().then_some(NAME)
    }

    pub(crate) fn stop(&mut self) {
        if let Err(error) = self.thread.finish() {
            tracing::warn!("{error}");
        }
    }
}

/// Work that the thread repeats.
#[derive(Debug)]
struct Rounds {
    domain: Domain,
    directory: File,
    config: Config,
    presence: Arc<Presence>,
    counts: Arc<Counts>,
    search: Search,
    round: u64,
}

impl Steps for Rounds {
    /// Cleans up until stopped, or until files of this process are missing.
    fn step(&mut self, last: bool) -> Option<Duration> {
        if last {
            return None;
        }
        // A joining process has just cleaned up.
        if self.round > 0
            && let Err(error) = self.clean()
        {
            // The files at the domain's paths now belong to another fleet or program.
            tracing::error!("{error}");
            // Fails if the directory is gone as well.
            let _ = Marked::fleet(&self.domain).restore(&self.directory);
            return None;
        }
        self.round += 1;
        Some(INCOMPLETE_EVERY)
    }
}

impl Rounds {
    fn clean(&mut self) -> Result<(), FilesRemoved> {
        self.presence.look()?;
        if let Ok(removed) = self.search.remove(&self.domain) {
            self.counts.incomplete.fetch_add(removed, Ordering::Relaxed);
            if removed > 0 {
                tracing::info!(removed, "removed incomplete objects of dead processes");
            }
        }
        if self.round.is_multiple_of(DEAD_NODES_EVERY) {
            self.remove_dead_nodes();
        }
        Ok(())
    }

    fn remove_dead_nodes(&self) {
        let (mut report, counts) = (SweepReport::default(), &self.counts);
        remove_dead_nodes(&self.config, &mut report);
        let (nodes, failed) = (report.dead_nodes, report.failed_nodes);
        counts.dead_nodes.fetch_add(nodes, Ordering::Relaxed);
        counts.failed_nodes.fetch_add(failed, Ordering::Relaxed);
        if nodes > 0 {
            tracing::info!(nodes, "removed nodes of dead processes");
        }
    }
}
