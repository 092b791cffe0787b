//! The checkpointer: a thread that reads the worker's own frames, as a planner would, and does what the
//! tick must not: writes the ledger's checkpoints and logs what was refused.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use joulebus_bus::{
    BudgetReader, Bus, DiagnosticReader, Domain, ForecastReader, JoinError, OpenError, clock,
};
use joulebus_config::Config;
use joulebus_wire::{DropCounts, DropReason};

use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::keyframes::{KeyframeOrders, KeyframeSender};

/// Period of the checkpointer.
const PERIOD: Duration = Duration::from_millis(200);
/// Times in a period that a keyframe is looked for while one is on its way.
const POLLS: u32 = 10;
/// Periods from one log of what was refused to the next.
const LOG_EVERY: u64 = 5;

/// Why the checkpointer could not begin.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointerError {
    /// It could not join.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The thread could not be started, or the machine's run is not known.
    #[error("the worker's checkpointer cannot start: {0}")]
    Start(#[from] std::io::Error),
    /// The thread died before it was ready.
    #[error("the worker's checkpointer died at start")]
    Died,
}

/// Failures of the worker's loop, counted by it and logged by the checkpointer.
#[derive(Debug, Default)]
pub(crate) struct Failures {
    pub unsent: AtomicU64,
    pub receive: AtomicU64,
    /// Ticks that left the diagnostics out.
    pub shed: AtomicU64,
}

/// The running thread; stops when dropped.
#[derive(Debug)]
pub(crate) struct Checkpointer {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Checkpointer {
    /// Starts the thread and waits until it reads. `before` is what an earlier run wrote down.
    pub(crate) fn start(
        domain: &Domain,
        config: &Config,
        before: Checkpoint,
        failures: Arc<Failures>,
        orders: KeyframeOrders,
    ) -> Result<Self, CheckpointerError> {
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, domain, config) = (Arc::clone(&stop), domain.clone(), config.clone());
        let (ready, started) = std::sync::mpsc::sync_channel(1);
        let thread = std::thread::Builder::new()
            .name("joulebus-checkpointer".to_owned())
            .spawn(move || {
                match CheckpointerLoop::open(&domain, &config, before, failures, orders) {
                    Ok(checkpointer) => {
                        // The worker waits on the other end.
                        let _ = ready.send(Ok(()));
                        checkpointer.run(&stopped);
                    }
                    Err(error) => {
                        let _ = ready.send(Err(error));
                    }
                }
            })?;
        started.recv().map_err(|_| CheckpointerError::Died)??;
        Ok(Self {
            stop,
            thread: Some(thread),
        })
    }

    /// Writes the last checkpoint and ends.
    pub(crate) fn finish(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            if thread.join().is_err() {
                tracing::error!("the worker's checkpointer panicked");
            }
        }
    }
}

impl Drop for Checkpointer {
    fn drop(&mut self) {
        self.finish();
    }
}

/// What belongs to the checkpointer's thread.
struct CheckpointerLoop {
    // Before the bus: ports go first.
    budgets: BudgetReader,
    diagnostics: DiagnosticReader,
    forecasts: ForecastReader,
    keyframes: KeyframeSender,
    _bus: Bus,
    failures: Arc<Failures>,
    checkpoint: Checkpoint,
    path: Option<PathBuf>,
    every: u64,
    changed: bool,
    drops: DropCounts,
    failed: (u64, u64),
    shed: u64,
    sheds: bool,
}

impl CheckpointerLoop {
    fn open(
        domain: &Domain,
        config: &Config,
        checkpoint: Checkpoint,
        failures: Arc<Failures>,
        orders: KeyframeOrders,
    ) -> Result<Self, CheckpointerError> {
        let bus = Bus::join(domain, "checkpointer")?;
        let limits = config.limits();
        let every = config
            .checkpoint_every_ns()
            .div_ceil(PERIOD.as_nanos() as u64);
        Ok(Self {
            budgets: bus.budget_reader(&limits)?,
            diagnostics: bus.diagnostic_reader(&limits)?,
            forecasts: bus.forecast_reader(&limits)?,
            keyframes: KeyframeSender::open(&bus, &limits, config.settings(), orders)?,
            _bus: bus,
            failures,
            checkpoint,
            path: config.checkpoint().map(ToOwned::to_owned),
            every: every.max(1),
            changed: false,
            drops: DropCounts::default(),
            failed: (0, 0),
            shed: 0,
            sheds: false,
        })
    }

    fn run(mut self, stop: &AtomicBool) {
        for period in 1_u64.. {
            let last = stop.load(Ordering::Relaxed);
            self.read_budgets();
            if last || period % self.every == 0 {
                self.write();
            }
            if last || period % LOG_EVERY == 0 {
                self.log();
            }
            if last {
                return;
            }
            self.wait();
        }
    }

    /// Until the next period; polls for a keyframe that is on its way.
    fn wait(&mut self) {
        self.keyframes.poll();
        if !self.keyframes.is_busy() {
            return std::thread::park_timeout(PERIOD);
        }
        for _ in 0..POLLS {
            std::thread::park_timeout(PERIOD / POLLS);
            self.keyframes.poll();
        }
    }

    fn read_budgets(&mut self) {
        match self.budgets.take_latest() {
            Ok(Some(frame)) => {
                self.checkpoint.take(frame.payload());
                self.checkpoint.written_ns = frame.header().sent_ns;
                self.checkpoint.written_unix_ns = frame.header().sent_unix_ns;
                self.changed = true;
            }
            Ok(None) => {}
            Err(error) => tracing::warn!(%error, "the checkpointer cannot read budgets"),
        }
    }

    fn write(&mut self) {
        let Some(path) = self.path.as_deref().filter(|_| self.changed) else {
            return;
        };
        match self.checkpoint.write(path) {
            Ok(()) => self.changed = false,
            Err(error) => tracing::error!(%error, "the ledger was not saved"),
        }
    }

    fn log(&mut self) {
        match self.forecasts.take_latest() {
            Ok(Some(frame)) => {
                let drops = frame.header().samples_dropped;
                let (newer, robots) = (drops.since(&self.drops), frame.payload().len());
                self.drops = drops;
                drop(frame);
                if newer.total() > 0 {
                    self.log_drops(&newer, robots);
                }
            }
            Ok(None) => {}
            Err(error) => tracing::warn!(%error, "the checkpointer cannot read forecasts"),
        }
        let failed = (
            self.failures.unsent.load(Ordering::Relaxed),
            self.failures.receive.load(Ordering::Relaxed),
        );
        if failed != self.failed {
            tracing::warn!(
                unsent = failed.0,
                receive = failed.1,
                "frames failed so far"
            );
            self.failed = failed;
        }
        self.log_shed();
    }

    /// One line when diagnostics begin to be left out, and one when they are back.
    fn log_shed(&mut self) {
        let before = std::mem::replace(&mut self.shed, self.failures.shed.load(Ordering::Relaxed));
        let (ticks, more) = (self.shed, self.shed > before);
        match (more, self.sheds) {
            (true, false) => tracing::warn!(
                ticks,
                "ticks take longer than their period: diagnostics are left out"
            ),
            (false, true) => tracing::info!(ticks, "ticks are in time again: diagnostics are back"),
            _ => {}
        }
        self.sheds = more;
    }

    fn log_drops(&mut self, newer: &DropCounts, robots: usize) {
        let named = match self.diagnostics.take_latest() {
            Ok(Some(frame)) => frame
                .header()
                .refusals()
                .filter(|refusal| refusal.reason().is_some_and(|reason| newer.get(reason) > 0))
                .map(|refusal| {
                    let reason = refusal.reason().map_or("unknown", DropReason::name);
                    format!("robot {} of pid {}: {reason}", refusal.robot, refusal.pid)
                })
                .collect::<Vec<String>>()
                .join(", "),
            _ => String::new(),
        };
        for (reason, count) in newer.iter() {
            tracing::warn!(reason = reason.name(), count, robots, "samples dropped");
        }
        if !named.is_empty() {
            tracing::warn!("recently refused: {named}");
        }
    }
}

/// What an earlier run wrote down for this fleet, made to fit the machine's present run.
pub(crate) fn read_checkpoint(config: &Config) -> Result<Checkpoint, CheckpointError> {
    let io = |source| CheckpointError::Io {
        path: "/proc/sys/kernel/random/boot_id".into(),
        source,
    };
    let boot_id = clock::boot_id().map_err(io)?;
    let read = match config.checkpoint() {
        Some(path) => Checkpoint::read(path, config.fleet())?,
        None => None,
    };
    let before = read.unwrap_or_else(|| Checkpoint::new(config.fleet(), &boot_id));
    Ok(before.carried_over(&boot_id, clock::monotonic_ns(), clock::unix_ns()))
}
