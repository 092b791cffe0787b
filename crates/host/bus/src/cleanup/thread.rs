//! The cleanup thread of each member: removes stale files of dead processes while members are
//! alive, and checks that the member's own files exist.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use iceoryx2::config::Config;

use super::dead_nodes::remove_dead_nodes;
use super::incomplete::Search;
use super::report::SweepReport;
use crate::Domain;
use crate::liveness::presence::{FilesRemoved, Presence};
use crate::marker::{Marked, open_directory};
use crate::os::fork;

/// A member may be blocked on an incomplete object, so this is frequent; most passes read no directory ([`Search`]).
const INCOMPLETE_EVERY: Duration = Duration::from_millis(250);
/// Number of rounds between searches for dead nodes: once a second.
const DEAD_NODES_EVERY: u64 = 4;

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
struct Shared {
    stop: Mutex<bool>,
    stopped: Condvar,
    dead_nodes: AtomicU64,
    failed_nodes: AtomicU64,
    incomplete: AtomicU64,
}

#[derive(Debug)]
pub(crate) struct CleanupThread {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl CleanupThread {
    pub(crate) fn start(
        domain: &Domain,
        config: &Config,
        presence: Arc<Presence>,
    ) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let (domain, config) = (domain.clone(), config.clone());
        let inside = Arc::clone(&shared);
        let directory = open_directory(&domain.directory())?;
        let thread = std::thread::Builder::new()
            .name("joulebus-clean".to_owned())
            .spawn(move || {
                if let Some(error) = inside.run(&domain, &config, &presence) {
                    // The files at the domain's paths now belong to another fleet or program.
                    tracing::error!("{error}");
                    Marked::fleet(&domain).restore(&directory);
                }
            })?;
        Ok(Self {
            shared,
            thread: Some(thread),
        })
    }

    pub(crate) fn counts(&self) -> Housekeeping {
        let shared = &self.shared;
        Housekeeping {
            dead_nodes: shared.dead_nodes.load(Ordering::Relaxed),
            failed_nodes: shared.failed_nodes.load(Ordering::Relaxed),
            incomplete: shared.incomplete.load(Ordering::Relaxed),
        }
    }

    pub(crate) fn stop(&mut self) {
        *self
            .shared
            .stop
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = true;
        self.shared.stopped.notify_all();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::warn!("the cleanup thread panicked");
        }
    }
}

impl Shared {
    /// Cleans up until stopped, or until files of this process are missing.
    fn run(&self, domain: &Domain, config: &Config, presence: &Presence) -> Option<FilesRemoved> {
        let mut search = Search::default();
        for round in 1_u64.. {
            if self.wait() {
                return None;
            }
            if let Err(error) = presence.look() {
                return Some(error);
            }
            if let Ok(removed) = search.remove(domain) {
                self.incomplete.fetch_add(removed, Ordering::Relaxed);
                if removed > 0 {
                    tracing::info!(removed, "removed incomplete objects of dead processes");
                }
            }
            if round % DEAD_NODES_EVERY == 0 {
                self.remove_dead_nodes(config);
            }
        }
        None
    }

    fn remove_dead_nodes(&self, config: &Config) {
        let mut report = SweepReport::default();
        let _section = fork::enter();
        remove_dead_nodes(config, &mut report);
        self.dead_nodes
            .fetch_add(report.dead_nodes, Ordering::Relaxed);
        self.failed_nodes
            .fetch_add(report.failed_nodes, Ordering::Relaxed);
        if report.dead_nodes > 0 {
            let nodes = report.dead_nodes;
            tracing::info!(nodes, "removed nodes of dead processes");
        }
    }

    /// Sleeps for one round; returns whether to stop.
    fn wait(&self) -> bool {
        let stop = self.stop.lock().unwrap_or_else(PoisonError::into_inner);
        let (stop, _) = self
            .stopped
            .wait_timeout_while(stop, INCOMPLETE_EVERY, |stop| !*stop)
            .unwrap_or_else(PoisonError::into_inner);
        *stop
    }
}
