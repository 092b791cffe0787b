//! The worker and its loop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use hdrhistogram::Histogram;
use joulebus_bus::{
    BudgetWriter, Bus, DiagnosticWriter, DomainError, ForecastWriter, FrameBuf, JoinError, Ports,
    RoomError, SampleReader, SchedulingError, WaitError, Waiter, Waker, WorkerLock,
    WorkerLockError, check_room, clock, set_timer_slack, touch_own_memory,
};
use joulebus_config::Config;
use joulebus_fleet::{Fleet, Next, Schedule, SettingsError, TickIntake};
use joulebus_wire::{BudgetHeader, DiagnosticHeader, ForecastHeader, SCHEMA_VERSION, WakeEvent};

use crate::checkpoint::CheckpointError;
use crate::clerk::{Clerk, ClerkError, Failures, recall};
use crate::journal::Journal;
use crate::keyframes::{Keyframes, keyframes};
use crate::models::{ModelsError, load_models};
use crate::report::{Report, Spread, by_name};

/// Longest tick that the histogram tells apart, ns.
const LONGEST_TICK_NS: u64 = 60_000_000_000;

/// A predictor-worker: the only one of its fleet.
pub struct Worker {
    fleet: Fleet,
    schedule: Schedule,
    // Ports before the bus, the bus before the lock: the order in which they must go.
    samples: SampleReader,
    forecasts: ForecastWriter,
    diagnostics: DiagnosticWriter,
    budgets: BudgetWriter,
    journal: Journal,
    keyframes: Keyframes,
    waiter: Waiter,
    planners: Waker,
    clerk: Clerk,
    _bus: Bus,
    _lock: WorkerLock,
    frame: FrameBuf,
    failures: Arc<Failures>,
    header: ForecastHeader,
    missed: bool,
    ticks_ns: Histogram<u64>,
    name: String,
}

/// Why a worker could not begin.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The config's domain.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// A model.
    #[error(transparent)]
    Models(#[from] ModelsError),
    /// The settings contradict themselves.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The ledger's checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Too little shared memory or too few descriptors.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// Another worker serves the fleet.
    #[error(transparent)]
    Lock(#[from] WorkerLockError),
    /// The domain could not be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Port(#[from] joulebus_bus::OpenError),
    /// The clerk could not begin.
    #[error(transparent)]
    Clerk(#[from] ClerkError),
    /// The system refused what the config requires of it.
    #[error("{0} (`worker.if_refused = \"stop\"` in the config)")]
    Scheduling(#[from] SchedulingError),
    /// The histogram of tick times.
    #[error("the histogram of tick times: {0}")]
    Histogram(#[from] hdrhistogram::CreationError),
}

/// Why a worker had to stop.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// It can no longer be woken, or wake.
    #[error(transparent)]
    Wait(#[from] WaitError),
}

impl Worker {
    /// Loads the models, takes the right to be the fleet's worker, checks that everything fits into
    /// shared memory, joins, opens the ports, and goes on with the ledger that was written down.
    ///
    /// # Errors
    /// The first thing that stands in the way, with its remedy.
    pub fn open(config: &Config) -> Result<Self, OpenError> {
        let models = load_models(config)?;
        let mut fleet = Fleet::new(config.settings().clone(), models)?;
        let domain = config.domain()?;
        let limits = config.limits();
        let lock = WorkerLock::acquire(&domain)?;
        let before = recall(config)?;
        let kept = before
            .ledgers()
            .filter(|(robot, ledger, charged)| fleet.restore(*robot, *ledger, *charged));
        let (kept, written) = (kept.count(), before.robots.len());
        if kept < written {
            tracing::warn!(
                kept,
                written,
                "more accounts written down than the fleet has room for: raise `capacity`"
            );
        }
        let frame = FrameBuf::new(limits.capacity);
        let ticks_ns = Histogram::new_with_bounds(1, LONGEST_TICK_NS, 3)?;
        // Before the other threads: their stacks need not be touched.
        touch_own_memory();
        check_room(
            &limits,
            Ports {
                sources: 1,
                workers: 1,
                planners: 1,
            },
        )?;
        let bus = Bus::join(&domain, "worker")?;
        let forecasts = bus.forecast_writer(&limits)?;
        let diagnostics = bus.diagnostic_writer(&limits)?;
        let budgets = bus.budget_writer(&limits)?;
        let journal = Journal::open(&bus, &limits)?;
        let planners = bus.planner_waker(&limits)?;
        let failures = Arc::new(Failures::default());
        let (keyframes, orders) = keyframes();
        let clerk = Clerk::start(&domain, config, before, Arc::clone(&failures), orders)?;
        // After the threads that must not have it: they inherit what their maker has.
        for refused in config.scheduling().apply()? {
            tracing::warn!("{refused}");
        }
        // Last: from here on samples come in, and everything is there to take them.
        let waiter = bus.arrivals_waiter(&limits)?;
        let samples = bus.sample_reader(&limits)?;
        let header = ForecastHeader {
            schema: SCHEMA_VERSION,
            pid: std::process::id(),
            worker_epoch: clock::unix_ns(),
            period_ns: config.tick_period_ns(),
            model_hash: fleet.model_hash(),
            capacity: fleet.capacity(),
            ..ForecastHeader::default()
        };
        keyframes.offer(&fleet, (header.worker_epoch, 0));
        let schedule = Schedule::new(
            config.policy(),
            config.tick_period_ns(),
            clock::monotonic_ns(),
        );
        Ok(Self {
            frame,
            ticks_ns,
            name: config.fleet().to_owned(),
            missed: false,
            fleet,
            schedule,
            samples,
            forecasts,
            diagnostics,
            budgets,
            journal,
            keyframes,
            waiter,
            planners,
            clerk,
            _bus: bus,
            _lock: lock,
            failures,
            header,
        })
    }

    /// Ticks until `stop` is set, which it notices within 100 ms, or at once when a signal sets it.
    /// Then tells planners and writes the ledger down.
    ///
    /// # Errors
    /// [`RunError`]: waiting itself has failed.
    pub fn run(mut self, stop: &AtomicBool) -> Result<Report, RunError> {
        if let Err(error) = set_timer_slack() {
            tracing::warn!(%error, "ticks may start 50 µs late");
        }
        while !stop.load(Ordering::Relaxed) {
            self.turn()?;
        }
        Ok(self.finish())
    }

    /// Takes what has come, and ticks if a tick is due; otherwise waits for a frame, for the next
    /// tick, or for a signal, 100 ms at most. Returns whether it ticked.
    ///
    /// # Errors
    /// As [`Worker::run`].
    pub fn turn(&mut self) -> Result<bool, RunError> {
        self.drain();
        let now_ns = clock::monotonic_ns();
        let taken_ns = self.fleet.intake().first.map(|(_, _, taken_ns)| taken_ns);
        match self
            .schedule
            .next(now_ns, taken_ns, self.fleet.complete(now_ns))
        {
            Next::Wait { until_ns } => {
                self.waiter.wait_until(Some(until_ns), None)?;
                Ok(false)
            }
            Next::Tick { due_ns } => {
                self.tick(due_ns, now_ns);
                Ok(true)
            }
        }
    }

    /// Tells planners that this was the end, writes the ledger down, and leaves.
    #[must_use]
    pub fn finish(mut self) -> Report {
        if let Err(error) = self.planners.wake(WakeEvent::Ended) {
            tracing::warn!(%error, "planners were not told of the end");
        }
        self.clerk.finish();
        self.report()
    }

    /// What the run has come to so far.
    #[must_use]
    pub fn report(&self) -> Report {
        Report {
            fleet: self.name.clone(),
            ticks: self.header.tick,
            ticks_skipped: self.schedule.skipped,
            ticks_late: self.schedule.late,
            robots: self.fleet.len(),
            samples_accepted: self.fleet.accepted(),
            samples_dropped: by_name(&self.fleet.drops()),
            frames_unsent: self.failures.unsent.load(Ordering::Relaxed),
            receive_errors: self.failures.receive.load(Ordering::Relaxed),
            tick: Spread::of(&self.ticks_ns),
        }
    }

    /// Takes all frames that wait: a bounded drain would starve the sources that come last. The
    /// buffers bound the work.
    fn drain(&mut self) {
        loop {
            match self.samples.take(&mut self.frame) {
                Ok(true) => {
                    let now_ns = clock::monotonic_ns();
                    self.journal.note(&self.frame, now_ns);
                    self.fleet
                        .take(self.frame.header(), self.frame.samples(), now_ns);
                }
                Ok(false) => return,
                Err(_) => {
                    self.failures.receive.fetch_add(1, Ordering::Relaxed);
                    return;
                }
            }
        }
    }

    fn tick(&mut self, due_ns: u64, start_ns: u64) {
        let missed = self.missed;
        let intake = self.fleet.tick(start_ns, missed);
        self.header.tick += 1;
        self.send_forecasts(intake, start_ns);
        self.send_diagnostics();
        self.send_budgets();
        let place = (self.header.worker_epoch, self.header.tick);
        self.journal
            .send(place, start_ns, missed, &self.failures.unsent);
        self.keyframes.offer(&self.fleet, place);
        let end_ns = clock::monotonic_ns();
        let frames = intake.frames > 0;
        self.missed = self.schedule.ticked(due_ns, start_ns, end_ns, frames);
        self.ticks_ns
            .saturating_record(end_ns.saturating_sub(start_ns));
    }

    /// Forecasts go first, and planners are woken for them: the rest can wait.
    fn send_forecasts(&mut self, intake: TickIntake, start_ns: u64) {
        let (first_intended_ns, first_sent_ns, first_taken_ns) = intake.first.unwrap_or_default();
        let Ok(mut loan) = self.forecasts.loan(self.fleet.len()) else {
            self.failures.unsent.fetch_add(1, Ordering::Relaxed);
            return;
        };
        for (place, forecast) in loan.iter_mut().enumerate() {
            *forecast = self.fleet.forecast(place);
        }
        let compute_end_ns = clock::monotonic_ns();
        *loan.header_mut() = ForecastHeader {
            frames_taken: intake.frames,
            first_intended_ns,
            first_sent_ns,
            first_taken_ns,
            compute_start_ns: start_ns,
            compute_end_ns,
            sent_unix_ns: clock::unix_ns(),
            sent_ns: clock::monotonic_ns(),
            ticks_skipped: self.schedule.skipped,
            ticks_late: self.schedule.late,
            samples_accepted: self.fleet.accepted(),
            samples_dropped: self.fleet.drops(),
            ..self.header
        };
        let sent = loan.send().is_ok() && self.planners.wake(WakeEvent::Frame).is_ok();
        self.count(sent);
    }

    fn send_diagnostics(&mut self) {
        let header = DiagnosticHeader {
            schema: SCHEMA_VERSION,
            pid: self.header.pid,
            worker_epoch: self.header.worker_epoch,
            tick: self.header.tick,
            refused: self.fleet.refusals(),
        };
        let sent = self.diagnostics.send(header, self.fleet.len(), |place| {
            self.fleet.diagnostic(place)
        });
        self.count(sent.is_ok());
    }

    fn send_budgets(&mut self) {
        let header = BudgetHeader {
            schema: SCHEMA_VERSION,
            pid: self.header.pid,
            worker_epoch: self.header.worker_epoch,
            tick: self.header.tick,
            sent_ns: clock::monotonic_ns(),
            sent_unix_ns: clock::unix_ns(),
        };
        let sent = self
            .budgets
            .send(header, self.fleet.len(), |place| self.fleet.budget(place));
        self.count(sent.is_ok());
    }

    fn count(&self, sent: bool) {
        self.failures
            .unsent
            .fetch_add(u64::from(!sent), Ordering::Relaxed);
    }
}
