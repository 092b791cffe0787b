#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod acknowledgements;
mod error;
mod fair;
mod job;
mod records;
mod server;
mod statements;

use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use joulebus_bus::{Background, Steps, ThreadWatch, clock, yield_to_the_worker};
use joulebus_config::Config;
use joulebus_models::{ModelsError, load_models};
use joulebus_plan::PlanFleet;
use joulebus_wire::QueryCounts;
use serde::Serialize;

use acknowledgements::Table;
use error::ServerError;
use server::Server;
pub use statements::Statements;

/// Pause before the ports are opened, and before a failed opening is tried again.
const OPEN_EVERY: Duration = Duration::from_millis(20);
/// Timeout of the first opening, for which a worker waits, and the interval of its checks.
const OPEN_TIMEOUT: Duration = Duration::from_secs(2);
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Failed openings in a row after which one is logged.
const LOG_AFTER: u32 = 50;

/// The thread that answers questions. Stopped when dropped.
#[derive(Debug)]
pub struct PlanServer {
    thread: Option<Background>,
    shared: Arc<Shared>,
}

/// State shared by the thread and its owner.
#[derive(Debug, Default)]
struct Shared {
    serves: AtomicBool,
    /// True once the ports have been opened, or could not be.
    tried: AtomicBool,
    counts: Mutex<QueryCounts>,
}

/// Questions answered and refused.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct QueryReport {
    /// Questions answered.
    pub answered: u64,
    /// Questions refused, by reason.
    pub refused: BTreeMap<&'static str, u64>,
}

/// Errors of starting the thread.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// A model could not be loaded.
    #[error(transparent)]
    Models(#[from] ModelsError),
    /// The system refuses the thread.
    #[error("the thread that answers questions cannot start: {0}")]
    Thread(#[from] io::Error),
}

impl PlanServer {
    /// Starts the thread, unless the config turns questions off. Call it before the worker is
    /// opened, because the thread would inherit the worker's CPUs and priority. It opens nothing
    /// yet.
    ///
    /// `statements` leads to the worker of this process. Without it a new normal and the state of a
    /// battery are refused.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(config: &Config, statements: Option<Statements>) -> Result<Self, StartError> {
        let shared = Arc::new(Shared::default());
        let thread = if config.queries().answer {
            let models = PlanFleet::new(config.settings(), &load_models(config)?);
            let (config, shared) = (config.clone(), Arc::clone(&shared));
            Some(Background::start("joulebus-queries", move || {
                Ok::<_, StartError>(Answering::new(config, models, shared, statements))
            })?)
        } else {
            None
        };
        Ok(Self { thread, shared })
    }

    /// Lets the thread answer questions. Only the process with the fleet's worker lock may call it,
    /// because clients accept answers from no other.
    pub fn serve(&self) {
        self.shared.serves.store(true, Ordering::Release);
        if let Some(thread) = &self.thread {
            thread.wake();
        }
    }

    /// Waits until the ports are open, so that a worker that is ready has all its memory, or could
    /// not be opened, at most two seconds. To be called after [`PlanServer::serve`].
    pub fn wait_until_open(&self) {
        if self.thread.is_none() {
            return;
        }
        let give_up = Instant::now() + OPEN_TIMEOUT;
        while !self.shared.tried.load(Ordering::Acquire) && Instant::now() < give_up {
            std::thread::sleep(POLL_INTERVAL);
        }
    }

    /// Tells whether the thread has ended, for a worker that must not go on without it. `None` if
    /// the config turns questions off.
    pub fn watch(&self) -> Option<ThreadWatch> {
        self.thread.as_ref().map(Background::watch)
    }

    /// Refuses the questions that wait, and ends the thread, within 100 ms.
    #[must_use]
    pub fn finish(mut self) -> QueryReport {
        if let Some(Err(error)) = self.thread.as_mut().map(Background::finish) {
            tracing::error!("{error}");
        }
        let counts = *self.shared.counts();
        QueryReport {
            answered: counts.answered,
            refused: counts.iter().map(|(reason, count)| (reason.name(), count)).collect(),
        }
    }
}

impl Shared {
    fn counts(&self) -> std::sync::MutexGuard<'_, QueryCounts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Answering {
    config: Config,
    models: PlanFleet,
    shared: Arc<Shared>,
    statements: Option<Statements>,
    server: Option<Server>,
    begun_ns: u64,
    counts: QueryCounts,
    /// Alarms that were acknowledged when the ports were lost.
    table: Table,
    failures: u32,
}

impl Answering {
    fn new(
        config: Config,
        models: PlanFleet,
        shared: Arc<Shared>,
        statements: Option<Statements>,
    ) -> Self {
        yield_to_the_worker(config.queries().nice);
        Self {
            config,
            models,
            shared,
            statements,
            server: None,
            begun_ns: clock::monotonic_ns(),
            counts: QueryCounts::default(),
            table: Table::default(),
            failures: 0,
        }
    }

    fn open(&mut self) {
        let before = (self.begun_ns, self.counts, self.table.clone());
        match Server::open(&self.config, &self.models, self.statements.as_ref(), before) {
            Ok(server) => {
                self.server = Some(server);
                self.failures = 0;
            }
            Err(error) => self.failed(&error),
        }
    }

    /// Logs an error that persists. The port of a killed worker stays until it is cleaned up.
    fn failed(&mut self, error: &ServerError) {
        self.failures += 1;
        if self.failures.is_multiple_of(LOG_AFTER) {
            tracing::warn!(%error, "questions about plans are not answered at present");
        }
    }
}

impl Steps for Answering {
    fn step(&mut self, last: bool) -> Option<Duration> {
        if self.server.is_none() && self.shared.serves.load(Ordering::Acquire) && !last {
            self.open();
            self.shared.tried.store(true, Ordering::Release);
        }
        let Some(server) = &mut self.server else {
            return (!last).then_some(OPEN_EVERY);
        };
        let served = if last { server.end() } else { server.round() };
        self.counts = server.counts();
        *self.shared.counts() = self.counts;
        if last {
            return None;
        }
        if served.is_err() && server.is_lost() {
            // The worker learns it too, and ends.
            self.shared.serves.store(false, Ordering::Release);
        }
        let needs_reopen = served.is_ok() && server.needs_reopen();
        if needs_reopen || served.is_err() {
            self.table = server.table();
        }
        match (served, self.server.take_if(|_| needs_reopen)) {
            (Ok(()), None) => return Some(Duration::ZERO),
            (Ok(()), Some(worn)) => match worn.renewed() {
                Ok(server) => {
                    self.server = Some(server);
                    return Some(Duration::ZERO);
                }
                Err(error) => self.failed(&error),
            },
            (Err(error), _) => {
                // Opens everything again, as after a kill.
                self.server = None;
                self.failed(&error);
            }
        }
        Some(OPEN_EVERY)
    }
}
