//! The worker and its loop.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::{io, mem};

use hdrhistogram::Histogram;
use joulebus_bus::{
    Background, Bus, FilesRemoved, Ports, ReceiveError, SampleReader, ThreadWatch, WaitError,
    Waiter, WorkerLock, check_capacity, clock, process_id, schedule_process, set_timer_slack,
    touch_own_memory,
};
use joulebus_config::{Config, Threads};
use joulebus_fleet::{Fleet, Next, RefusalLog, Schedule, TickIntake};
use joulebus_settings::Policy;
use joulebus_wire::{
    ForecastHeader, FrameHeader as _, FrameOrder, SCHEMA_VERSION, Sample, Statement, tick_flag,
};

use crate::checkpoint::SentErrors;
use crate::checkpointer::{
    self, Failures, StatedBatteries, THREAD as CHECKPOINTER, WorkerEnds, read_ledger,
};
use crate::error::OpenError;
use crate::journal::Journal;
use crate::keyframes::{Keyframes, keyframes};
use crate::outbox::Outbox;
use crate::pause;
use crate::report::{Parts, Report, by_name};
use crate::shedding::Shedding;
use crate::source_ports::SourcePorts;
use crate::standby::backlog::Held;
use crate::standby::follow::Following;
use crate::standby::watch::{self, CurrentPermit, PermitOver};
use crate::tick_pool::TickPool;
use joulebus_connect::standby::{Permit, PermitError, SavedState, StandbyFiles};
use joulebus_latency::{Spread, histogram};
use joulebus_models::load_models;

/// Interval at which a standby worker checks its permit, ns.
const PERMIT_EVERY_NS: u64 = watch::READ_EVERY.as_nanos() as u64;

/// Samples copied at a time before they are checked, so that they stay in the core's cache.
const PART: usize = 512;

/// A predictor-worker: the only one of its fleet.
#[derive(Debug)]
pub struct Worker {
    fleet: Fleet,
    schedule: Schedule,
    // Drop order: ports before the bus, the bus before the lock.
    samples: SampleReader,
    source_ports: SourcePorts,
    outbox: Outbox,
    journal: Journal,
    keyframes: Keyframes,
    waiter: Waiter,
    policy: Policy,
    pool: TickPool,
    checkpointer: Background,
    bus: Bus,
    _lock: WorkerLock,
    /// Buffer into which samples are copied before they are checked.
    part: Vec<Sample>,
    failures: Arc<Failures>,
    /// The errors of the energy, for the ledger.
    errors: Arc<SentErrors>,
    header: ForecastHeader,
    missed: bool,
    shedding: Shedding,
    ticks_ns: Histogram<u64>,
    intake_ns: u64,
    turns: Arc<AtomicU64>,
    name: String,
    current_permit: Arc<CurrentPermit>,
    phase: Phase,
    /// What persons state of robots.
    statements: Option<Receiver<(u32, Statement)>>,
    /// How many of these a tick has taken whose budgets and journal are sent.
    taken: Arc<AtomicU64>,
    /// How many more were taken.
    uncounted: u64,
    stated_batteries: StatedBatteries,
    /// Refusals, for another thread.
    refusals: Option<Arc<Mutex<RefusalLog>>>,
    /// Threads of others whose end ends the run.
    needed: Vec<ThreadWatch>,
}

/// Whether a worker serves, and by what right.
///
/// A worker without standby serves `Alone` from its start to its end. One that stands by is
/// `Following` its leader elsewhere until the link writes a permit for this host. It then takes the
/// leader's newest state and the samples since, and is `Leading` while a thread reads the permit.
/// When the permit ends, the tick reads its file once more: a late renewal counts. Else it is `Over`,
/// and the run ends. No way leads back, because a later permit is another process's.
#[derive(Debug, Default)]
enum Phase {
    #[default]
    Alone,
    Following {
        files: StandbyFiles,
        following: Following,
        /// When it checks for a permit, monotonic ns.
        look_ns: u64,
    },
    Leading {
        files: StandbyFiles,
        /// Keeps `current_permit` up to date.
        renewal: Background,
    },
    Over {
        files: StandbyFiles,
        renewal: Background,
    },
}

impl Phase {
    /// The phase after the end of the permit.
    fn over(self) -> Self {
        match self {
            Self::Leading { files, renewal } => Self::Over { files, renewal },
            other => other,
        }
    }

    const fn files(&self) -> Option<&StandbyFiles> {
        match self {
            Self::Alone => None,
            Self::Following { files, .. }
            | Self::Leading { files, .. }
            | Self::Over { files, .. } => Some(files),
        }
    }

    const fn renewal(&self) -> Option<&Background> {
        match self {
            Self::Alone | Self::Following { .. } => None,
            Self::Leading { renewal, .. } | Self::Over { renewal, .. } => Some(renewal),
        }
    }
}

/// Errors that stop a worker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum RunError {
    /// Waiting or waking failed.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// Files that it shares with other processes were removed. A new worker makes them again, as
    /// after every kill. To rebuild the ports of a running worker would be a second code path.
    #[error(transparent)]
    Removed(#[from] FilesRemoved),
    /// Another host's worker may serve.
    #[error(transparent)]
    Permit(#[from] PermitOver),
    /// The permit's file is something else.
    #[error(transparent)]
    PermitFile(#[from] PermitError),
    /// The thread that reads the permit could not be started.
    #[error("the thread that reads the permit cannot start: {0}")]
    Renewal(io::Error),
    /// A thread that the worker needs has ended.
    #[error(
        "the thread {name} has ended, which is a defect of joulebus: please report it with the log. \
         This worker ends, so that the next one has all its threads: start it, or let a \
         supervisor do that"
    )]
    Thread { name: String },
}

impl Worker {
    /// Loads the models, takes the fleet's worker lock, checks that everything fits into shared
    /// memory, joins, opens the ports, and restores the saved ledger.
    ///
    /// # Errors
    /// The first error, with its remedy.
    pub fn open(config: &Config) -> Result<Self, OpenError> {
        Self::open_as(config, Arc::new(CurrentPermit::always()))
    }

    /// Same as [`Worker::open`], for a worker that serves only with a permit. [`Worker::stand_by`]
    /// waits for it.
    ///
    /// # Errors
    /// Those of [`Worker::open`].
    pub fn open_standby(config: &Config) -> Result<Self, OpenError> {
        let mut worker = Self::open_as(config, Arc::new(CurrentPermit::not_yet()))?;
        let following = Following::new(config.settings(), worker.header.period_ns);
        let files = StandbyFiles::new(config);
        // What is left of the permit of the worker before shows the link that it still hangs. If it
        // cannot be read or removed, standing by reports it.
        if matches!(Permit::read(&files.permit), Ok(Some(permit)) if !permit.holds(clock::boot_ns()))
        {
            let _ = Permit::withdraw(&files.permit);
        }
        worker.phase = Phase::Following { files, following, look_ns: 0 };
        Ok(worker)
    }

    fn open_as(config: &Config, current_permit: Arc<CurrentPermit>) -> Result<Self, OpenError> {
        let models = load_models(config)?;
        let mut fleet = Fleet::new(config.settings().clone(), models)?;
        let domain = config.domain()?;
        let limits = config.limits();
        let lock = WorkerLock::acquire(&domain)?;
        let before = read_ledger(config)?;
        // Accounts of robots that the config no longer names stay in the file: those may return.
        let saved = before.checkpoint.ledgers().into_iter();
        let saved: Vec<_> = saved.filter(|account| fleet.is_configured(account.robot)).collect();
        let written = saved.len();
        before.checkpoint.lost.iter().for_each(|ids| fleet.lose(*ids));
        let kept = saved
            .iter()
            .filter(|account| {
                fleet.restore(account.robot, account.ledger, account.charged, account.battery)
            })
            .count();
        if kept < written {
            tracing::warn!(
                kept,
                written,
                "more accounts saved than the capacity of the fleet, and the other robots' batteries are \
                 unknown until measured or full: raise `capacity`"
            );
        }
        before.checkpoint.restore_errors(&mut fleet);
        for line in pause::first_lines(config.settings(), &saved, clock::monotonic_ns()) {
            tracing::warn!("{line}");
        }
        let errors = Arc::new(SentErrors::new(&fleet));
        let mut part = vec![Sample::new(0, 0, 0); PART];
        part.clear();
        let ticks_ns = histogram();
        // Before the other threads are started, whose stacks are not touched.
        touch_own_memory();
        let mut bus = Bus::join(&domain, "worker")?;
        // After joining, which frees the resources of dead processes.
        check_capacity(&limits, Ports { sources: 1, workers: 1, planners: 1 })?;
        bus.needs_lock(&lock);
        let outbox = Outbox::open(&bus, &limits)?;
        let journal = Journal::open(&bus, &limits)?;
        let failures = Arc::new(Failures::default());
        let (keyframes, orders) = keyframes(Arc::clone(&current_permit));
        let (stated_batteries, stated, taken) = StatedBatteries::channel();
        let checkpointer = checkpointer::start(
            &domain,
            config,
            before,
            WorkerEnds {
                failures: Arc::clone(&failures),
                errors: Arc::clone(&errors),
                orders,
                stated,
                taken,
            },
        )?;
        // After the threads that must not have it are started, because threads inherit it.
        for refused in schedule_process(config.scheduling())? {
            tracing::warn!("{refused}");
        }
        let Threads { count, from } = config.threads();
        let pool = TickPool::new(count, from, config.scheduling())?;
        // Last: from here on samples arrive.
        let waiter = bus.arrivals_waiter(&limits)?;
        let samples = bus.sample_reader(&limits)?;
        let header = ForecastHeader {
            schema: SCHEMA_VERSION,
            pid: process_id(),
            worker_epoch: clock::monotonic_ns(),
            period_ns: config.tick_period_ns(),
            ..ForecastHeader::default()
        };
        if current_permit.holds(clock::boot_ns()) {
            keyframes.offer(&fleet, header.order());
        }
        let schedule =
            Schedule::new(config.policy(), config.tick_period_ns(), clock::monotonic_ns());
        Ok(Self {
            part,
            ticks_ns,
            name: config.fleet().to_owned(),
            missed: false,
            intake_ns: 0,
            turns: Arc::default(),
            shedding: Shedding::default(),
            fleet,
            schedule,
            samples,
            source_ports: SourcePorts::new(),
            outbox,
            journal,
            keyframes,
            waiter,
            policy: config.policy(),
            pool,
            checkpointer,
            bus,
            _lock: lock,
            failures,
            errors,
            header,
            current_permit,
            phase: Phase::Alone,
            statements: None,
            taken: Arc::default(),
            uncounted: 0,
            stated_batteries,
            refusals: None,
            needed: Vec::new(),
        })
    }

    /// Waits until this host's worker gets a permit, and then continues where the previous leader
    /// ended: from its newest state on this host, and from the samples since. Returns false if
    /// `stop` was set first.
    ///
    /// # Errors
    /// Those of [`Worker::run`], or the permit's file is something else.
    pub fn stand_by(&mut self, stop: &AtomicBool) -> Result<bool, RunError> {
        while !stop.load(Ordering::Relaxed) {
            if self.stand_by_once()? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// One round of [`Worker::stand_by`]. Returns whether this worker serves.
    ///
    /// # Errors
    /// Those of [`Worker::stand_by`].
    pub fn stand_by_once(&mut self) -> Result<bool, RunError> {
        if !matches!(self.phase, Phase::Following { .. }) {
            return Ok(true);
        }
        self.turns.fetch_add(1, Ordering::Relaxed);
        self.bus.check()?;
        if let Some(name) = self.ended_thread() {
            return Err(RunError::Thread { name });
        }
        let Phase::Following { files, following, look_ns } = &mut self.phase else {
            return Ok(true);
        };
        let (samples, buffer, fleet) = (&mut self.samples, &mut self.part, &mut self.fleet);
        if hold(samples, buffer, following, fleet, files).is_err() {
            self.failures.receive.fetch_add(1, Ordering::Relaxed);
        }
        let now_ns = clock::monotonic_ns();
        if now_ns >= *look_ns {
            *look_ns = now_ns.saturating_add(PERMIT_EVERY_NS);
            if let Some(permit) = Permit::read(&files.permit)? {
                // This worker hung while its host led: the link gives no permit to this process.
                if !permit.holds(clock::boot_ns()) {
                    return Err(PermitOver { term: permit.term }.into());
                }
                self.take_over(&permit)?;
                return Ok(true);
            }
        }
        let until_ns = *look_ns;
        self.waiter.wait_until(Some(until_ns), None)?;
        Ok(false)
    }

    /// Leaves the last state of a worker that has served with a permit to the next one on this
    /// host, which may be itself: as after a lease that ran out because the store was away.
    fn leave_state(&self) {
        let term = self.current_permit.term();
        if let Some(files) = self.phase.files()
            && term > 0
        {
            let mut bytes = Vec::new();
            self.fleet.state().encode_into(&mut bytes);
            let of = (term, clock::monotonic_ns(), 0);
            if let Err(error) = SavedState::write(&files.keyframe, of, &bytes) {
                tracing::warn!("the next worker begins with an older state: {error}");
            }
        }
    }

    /// Continues where the leader ended.
    fn take_over(&mut self, permit: &Permit) -> Result<(), RunError> {
        let Phase::Following { files, following, .. } = &mut self.phase else {
            return Ok(());
        };
        let (restored, replayed) = following.take_over(&mut self.fleet, files, &self.turns);
        let files = files.clone();
        let current_permit = Arc::clone(&self.current_permit);
        let renewal = watch::start(files.permit.clone(), current_permit, permit);
        self.phase = Phase::Leading { files, renewal: renewal.map_err(RunError::Renewal)? };
        let now_ns = clock::monotonic_ns();
        self.header.worker_epoch = now_ns;
        self.schedule = Schedule::new(self.policy, self.header.period_ns, now_ns);
        self.keyframes.offer(&self.fleet, FrameOrder { run: now_ns, number: 0 });
        tracing::info!(
            term = permit.term,
            robots = self.fleet.len(),
            state_of_term = restored.map(|state| state.term),
            state_age_ms = restored.map(|state| now_ns.saturating_sub(state.taken_ns) / 1_000_000),
            frames = replayed.frames,
            samples = replayed.samples,
            "this worker serves"
        );
        Ok(())
    }

    /// Counts its turns there from now on, at least ten a second: a watchdog in another thread sees
    /// whether the worker works.
    #[doc(hidden)]
    pub fn count_turns_in(&mut self, turns: Arc<AtomicU64>) {
        self.turns = turns;
    }

    /// From now on the run ends if this thread does. Of its own threads the worker sees that
    /// anyway.
    #[doc(hidden)]
    pub fn needs(&mut self, thread: ThreadWatch) {
        self.needed.push(thread);
    }

    /// Takes from there what persons state of robots: see [`Fleet::take_statement`]. The channel's
    /// bound is how many wait for a tick at most. Counts in `taken` those that a tick has taken
    /// whose budgets and journal are sent.
    #[doc(hidden)]
    pub fn take_statements_from(
        &mut self,
        statements: Receiver<(u32, Statement)>,
        taken: Arc<AtomicU64>,
    ) {
        (self.statements, self.taken) = (Some(statements), taken);
    }

    /// Copies the refusals there after each tick, unless another thread has the lock at that moment.
    #[doc(hidden)]
    pub fn tell_refusals_to(&mut self, refusals: Arc<Mutex<RefusalLog>>) {
        self.refusals = Some(refusals);
    }

    /// Ticks until `stop` is set, which is noticed within 100 ms, or at once when a signal sets it.
    /// Samples that arrived before are taken, and counted in the report. The fleet belongs to this
    /// process until [`Worker::finish`].
    ///
    /// # Errors
    /// [`RunError`]: waiting failed, files were removed, the permit is over, or a thread has ended.
    pub fn run(&mut self, stop: &AtomicBool) -> Result<(), RunError> {
        if let Err(error) = set_timer_slack() {
            tracing::warn!(%error, "ticks may start 50 µs late");
        }
        while !stop.load(Ordering::Relaxed) {
            if let Err(error) = self.poll() {
                // Notify planners. Dropping the rest saves the ledger.
                self.outbox.end();
                return Err(error);
            }
        }
        // If this thread gets no processor, the stop may come before frames that were sent earlier
        // are taken.
        self.drain();
        Ok(())
    }

    /// Receives frames, and ticks if a tick is due. Otherwise waits for a frame, for the next tick,
    /// or for a signal, 100 ms at most. Returns whether it ticked.
    ///
    /// # Errors
    /// As [`Worker::run`].
    pub fn poll(&mut self) -> Result<bool, RunError> {
        self.turns.fetch_add(1, Ordering::Relaxed);
        self.bus.check()?;
        // Looked at before the permit: the thread that reads it ends with it.
        let ended = self.ended_thread();
        fence(Ordering::Acquire);
        self.drain();
        let now_ns = clock::monotonic_ns();
        if !self.current_permit.holds(clock::boot_ns()) && !self.is_renewed() {
            return Err(self.current_permit.over().into());
        }
        if let Some(name) = ended {
            return Err(RunError::Thread { name });
        }
        let taken_ns = self.fleet.intake().first.map(|(_, _, taken_ns)| taken_ns);
        match self.schedule.next(now_ns, taken_ns, self.fleet.complete(now_ns)) {
            Next::Wait { until_ns } => {
                self.waiter.wait_until(Some(until_ns), None)?;
                // Of several frames of a tick only the first wakes the pool.
                if self.fleet.intake().frames == 0 {
                    self.pool.wake(self.fleet.len());
                }
                Ok(false)
            }
            Next::Tick { due_ns } => {
                self.tick(due_ns, now_ns);
                Ok(true)
            }
        }
    }

    /// Reads the permit once more before the run ends: the link may have renewed it while this
    /// process had no processor.
    fn is_renewed(&mut self) -> bool {
        let Phase::Leading { files, .. } = &self.phase else {
            return false;
        };
        let permit = Permit::read(&files.permit);
        let is_renewed = permit.is_ok_and(|permit| self.current_permit.read_again(permit.as_ref()));
        if !is_renewed {
            self.phase = mem::take(&mut self.phase).over();
        }
        is_renewed
    }

    /// A thread without which the run must not go on, and which has ended. Neither allocates nor
    /// locks unless there is one.
    fn ended_thread(&self) -> Option<String> {
        let own = [(Some(&self.checkpointer), CHECKPOINTER), (self.phase.renewal(), watch::THREAD)];
        let own = own.iter().find(|(thread, _)| thread.is_some_and(Background::has_ended));
        let needed = || self.needed.iter().find(|thread| thread.has_ended()).map(ThreadWatch::name);
        let ended = own.map(|(_, name)| *name).or_else(|| self.bus.ended_thread()).or_else(needed);
        ended.map(str::to_owned)
    }

    /// Sends planners the end event, saves the ledger, and leaves the domain.
    #[must_use]
    pub fn finish(mut self) -> Report {
        self.outbox.end();
        if let Err(error) = self.checkpointer.finish() {
            self.failures.unsaved.store(true, Ordering::Relaxed);
            tracing::error!("{error}: the ledger was not saved");
        }
        self.leave_state();
        self.report()
    }

    /// The report so far.
    pub fn report(&self) -> Report {
        Report {
            fleet: self.name.clone(),
            ticks: self.header.tick,
            ticks_skipped: self.schedule.skipped,
            ticks_late: self.schedule.late,
            ticks_without_diagnostics: self.shedding.ticks,
            robots: self.fleet.len(),
            samples_accepted: self.fleet.accepted(),
            samples_dropped: by_name(&self.fleet.drops()),
            frames_unsent: self.failures.unsent.load(Ordering::Relaxed),
            receive_errors: self.failures.receive.load(Ordering::Relaxed),
            ledger_unsaved: self.failures.unsaved.load(Ordering::Relaxed),
            tick: Spread::new(&self.ticks_ns),
            parts: Parts::new(self.header.tick, self.intake_ns, self.pool.spent()),
        }
    }

    /// Receives all waiting frames: a bounded drain would starve the last sources. The buffers
    /// bound the work.
    ///
    /// 1. Look which sources have no port any more. They have sent nothing since.
    /// 2. Take each frame. The first frame of a source after that look may be the successor of one
    ///    whose port is gone: end the gone ones before it.
    /// 3. Note the frame in the journal before the fleet checks it, so that replays see it too.
    /// 4. Check the frame, then its samples part by part, while they are in the core's cache.
    /// 5. When no frame waits, end the gone sources. After an error they end with the next drain.
    fn drain(&mut self) {
        self.source_ports.look(clock::monotonic_ns());
        loop {
            let since_ns = clock::monotonic_ns();
            match self.samples.next(self.fleet.capacity() as usize) {
                Ok(Some(mut incoming)) => {
                    let now_ns = clock::monotonic_ns();
                    if self.source_ports.begin(&incoming) {
                        let ports = &mut self.source_ports;
                        end_gone(ports, &mut self.journal, &mut self.fleet, now_ns);
                    }
                    self.journal.note(&incoming, now_ns);
                    let count = incoming.len() as u64;
                    let frame = self.fleet.begin_frame(incoming.header(), count, now_ns);
                    if frame.is_admitted() {
                        self.source_ports.admitted(&incoming);
                    }
                    while let Some(part) = incoming.copy_part(&mut self.part) {
                        self.fleet.take_part(&frame, part);
                    }
                    self.intake_ns += clock::monotonic_ns().saturating_sub(since_ns);
                }
                Ok(None) => {
                    let (ports, now_ns) = (&mut self.source_ports, clock::monotonic_ns());
                    return end_gone(ports, &mut self.journal, &mut self.fleet, now_ns);
                }
                Err(_) => {
                    self.failures.receive.fetch_add(1, Ordering::Relaxed);
                    return;
                }
            }
        }
    }

    /// Takes the statements that wait. Those for which journal or ledger have no room wait for the
    /// next tick. Neither blocks nor locks: whoever sends them does not wait for room in the
    /// channel.
    fn take_statements(&mut self, now_ns: u64) {
        let Some(statements) = &self.statements else {
            return;
        };
        while self.stated_batteries.has_room()
            && let Ok((robot, stated)) = statements.try_recv()
        {
            self.journal.note_statement(robot, stated, now_ns);
            if let Some(battery) = self.fleet.take_statement(robot, stated, now_ns) {
                self.stated_batteries.send(battery);
            }
            self.uncounted += 1;
            // After one at least: the frames of a flooding source may fill each journal.
            if !self.journal.has_room() {
                break;
            }
        }
    }

    fn tick(&mut self, due_ns: u64, start_ns: u64) {
        let missed = self.missed;
        self.take_statements(start_ns);
        let intake = self.fleet.begin(start_ns, missed);
        self.header.tick += 1;
        let header = self.header_of(intake, start_ns);
        let flags = self.outbox.flags(self.shedding.sheds);
        let (outbox, permit) = (&mut self.outbox, &self.current_permit);
        let unsent = outbox.tick(&mut self.fleet, &self.pool, header, flags, permit);
        let unsent_before = self.failures.unsent.fetch_add(unsent, Ordering::Relaxed);
        if !self.current_permit.holds(clock::boot_ns()) {
            // The next turn ends it.
            return;
        }
        let order = self.header.order();
        let flags = flags | if missed { tick_flag::DEADLINE_MISSED } else { 0 };
        self.journal.send(order, start_ns, flags, &self.failures.unsent);
        if self.failures.unsent.load(Ordering::Relaxed) == unsent_before {
            self.taken.fetch_add(std::mem::take(&mut self.uncounted), Ordering::Release);
        }
        self.keyframes.offer(&self.fleet, order);
        self.errors.send(&self.fleet);
        if let Some(refusals) = &self.refusals
            && let Ok(mut refusals) = refusals.try_lock()
        {
            refusals.follow(self.fleet.refusal_log());
        }
        let end_ns = clock::monotonic_ns();
        let frames = intake.frames > 0;
        self.missed = self.schedule.ticked(due_ns, start_ns, end_ns, frames);
        let took_ns = end_ns.saturating_sub(start_ns);
        self.shedding.ticked(took_ns, self.header.period_ns);
        self.failures.shed.store(self.shedding.ticks, Ordering::Relaxed);
        self.ticks_ns.saturating_record(took_ns);
    }

    /// The header of this tick's forecasts, without the fields known only when they are sent.
    fn header_of(&self, intake: TickIntake, start_ns: u64) -> ForecastHeader {
        ForecastHeader {
            schema: SCHEMA_VERSION,
            pid: self.header.pid,
            worker_epoch: self.header.worker_epoch,
            tick: self.header.tick,
            period_ns: self.header.period_ns,
            ticks_skipped: self.schedule.skipped,
            ticks_late: self.schedule.late,
            ..self.fleet.header(intake, start_ns)
        }
    }
}

/// Keeps the frames that wait.
fn hold(
    samples: &mut SampleReader,
    buffer: &mut Vec<Sample>,
    following: &mut Following,
    fleet: &mut Fleet,
    files: &StandbyFiles,
) -> Result<(), ReceiveError> {
    let received = loop {
        match samples.next(fleet.capacity() as usize) {
            Ok(Some(mut incoming)) => {
                let taken_ns = clock::monotonic_ns();
                let mut samples = Vec::with_capacity(incoming.len());
                while let Some(part) = incoming.copy_part(buffer) {
                    samples.extend_from_slice(part);
                }
                let header = *incoming.header();
                let has_room = following.keep(Held { header, samples, taken_ns });
                if !has_room {
                    following.advance(fleet, files);
                }
            }
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    following.advance(fleet, files);
    received
}

/// Ends the sources whose ports are gone.
fn end_gone(ports: &mut SourcePorts, journal: &mut Journal, fleet: &mut Fleet, now_ns: u64) {
    ports.end_gone(|(source, epoch)| {
        journal.note_source_ended(source, epoch, now_ns);
        fleet.end_source(source, epoch);
    });
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use joulebus_bus::Steps;

    use super::*;

    /// Work that panics, as a defect would make it.
    struct Panics;

    impl Steps for Panics {
        fn step(&mut self, _: bool) -> Option<Duration> {
            panic!("a defect")
        }
    }

    /// Work without end.
    struct Idles;

    impl Steps for Idles {
        fn step(&mut self, last: bool) -> Option<Duration> {
            (!last).then_some(Duration::from_millis(50))
        }
    }

    const PANICS: &str = "joulebus-panics";

    fn panicking() -> Background {
        Background::start(PANICS, || Ok::<_, io::Error>(Panics)).unwrap()
    }

    fn config(root: &std::path::Path) -> Config {
        let text = format!(
            "[fleet]\nname = \"threads\"\ncapacity = 2\n[domain]\nroot = \"{}\"\nprefix = \"t_\"\n\
             [ledger]\ncheckpoint = \"\"\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [1, 2]\n",
            root.display()
        );
        Config::parse(&text, &root.join("nowhere")).unwrap()
    }

    #[test]
    fn a_worker_without_a_processor_goes_on_if_its_permit_was_renewed_and_ends_with_it() {
        let root = format!("/dev/shm/joulebus-test-renewed-{}", std::process::id());
        let root = std::path::PathBuf::from(root);
        let config = config(&root);
        let mut worker = Worker::open(&config).unwrap();
        let files = StandbyFiles::new(&config);
        // The thread that reads the permit has not had a processor since the first one.
        worker.current_permit = Arc::new(CurrentPermit::not_yet());
        worker.current_permit.begin(&Permit { term: 4, until_ns: 1, lease: 9 });
        let renewal = || Background::start("idle", || Ok::<_, io::Error>(Idles)).unwrap();
        let leading = || Phase::Leading { files: files.clone(), renewal: renewal() };
        worker.phase = leading();
        let renewed = |term, until_ns| Permit { term, until_ns, lease: 9 };
        renewed(4, u64::MAX - 1).write(&files.permit).unwrap();
        assert!(worker.poll().is_ok());
        for permit in [Some(renewed(4, 2)), Some(renewed(5, u64::MAX - 1)), None] {
            worker.phase = leading();
            match permit {
                Some(permit) => permit.write(&files.permit).unwrap(),
                None => Permit::withdraw(&files.permit).unwrap(),
            }
            worker.current_permit.begin(&renewed(4, 1));
            assert!(matches!(worker.poll(), Err(RunError::Permit(_))), "{permit:?}");
        }
        let _ = worker.finish();
        let _ = std::fs::remove_dir_all(&root);
    }

    /// A worker ticks until that is the case. Returns it.
    fn tick(mut worker: Worker, mut until: impl FnMut(&Worker) -> bool) -> Worker {
        let begun_ns = clock::monotonic_ns();
        while !worker.poll().unwrap() || !until(&worker) {
            assert!(clock::monotonic_ns() - begun_ns < 180_000_000_000, "not after three minutes");
        }
        worker
    }

    #[test]
    fn what_is_stated_of_a_robot_that_is_not_there_outlasts_the_worker() {
        let folder = tempfile::tempdir().unwrap();
        let root = format!("/dev/shm/joulebus-test-absent-{}", std::process::id());
        let root = std::path::PathBuf::from(root);
        let ledger = folder.path().join("ledger.json");
        let text = format!(
            "[fleet]\nname = \"absent\"\ncapacity = 2\n[domain]\nroot = {root:?}\nprefix = \"t_\"\n\
             [ledger]\ncheckpoint = {ledger:?}\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [1, 2]\n"
        );
        let config = Config::parse(&text, &root.join("nowhere")).unwrap();
        let saved = || -> Option<serde_json::Value> {
            let saved = serde_json::from_slice::<serde_json::Value>(&std::fs::read(&ledger).ok()?);
            Some(saved.ok()?["ledger"]["robots"]["1"].take())
        };
        let worker = Worker::open(&config).unwrap();
        let bus = Bus::join(&config.domain().unwrap(), "source").unwrap();
        let mut source = bus.sample_writer(&config.limits(), 1).unwrap();
        let now_ns = clock::monotonic_ns();
        let header = joulebus_wire::SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 1,
            source_epoch: now_ns,
            sent_ns: now_ns,
            ..Default::default()
        };
        let sample = Sample::new(1, 0, now_ns).command(0.1, 0.0).reading(3.5, now_ns);
        source.send(header, 1, |_| sample).unwrap();
        let worker = tick(worker, |worker| worker.report().samples_accepted == 1);
        drop((source, bus));
        let _ = worker.finish();
        let (to, statements) = std::sync::mpsc::sync_channel(2);
        let mut worker = Worker::open(&config).unwrap();
        let taken = Arc::<AtomicU64>::default();
        worker.take_statements_from(statements, Arc::clone(&taken));
        to.send((1, Statement::Charge(0.375))).unwrap();
        // The ledger knows nothing of this one.
        to.send((2, Statement::Full)).unwrap();
        let _ = tick(worker, |_| taken.load(Ordering::Relaxed) == 2).finish();
        let robot = saved().unwrap();
        assert_eq!((&robot["battery"]["soc"], &robot["stamp_ns"]), (&0.375.into(), &now_ns.into()));
        assert!(robot["battery"]["soc_lo"].as_f64() > Some(0.2), "{robot}");
        // The robot comes back to the next one.
        let worker = Worker::open(&config).unwrap();
        let bus = Bus::join(&config.domain().unwrap(), "source").unwrap();
        let mut source = bus.sample_writer(&config.limits(), 1).unwrap();
        let mut budgets = bus.reader::<joulebus_wire::Budgets>(&config.limits()).unwrap();
        let now_ns = clock::monotonic_ns();
        let header =
            joulebus_wire::SampleHeader { source_epoch: now_ns, sent_ns: now_ns, ..header };
        let sample = Sample::new(1, 0, now_ns).command(0.1, 0.0).reading(3.5, now_ns);
        source.send(header, 1, |_| sample).unwrap();
        let mut soc = f32::NAN;
        let worker = tick(worker, |_| {
            budgets.take_all(|_, rows| soc = rows.first().map_or(soc, |row| row.soc)).unwrap();
            !soc.is_nan()
        });
        assert!((soc - 0.375).abs() < 0.02, "{soc}");
        drop((source, budgets, bus));
        let _ = worker.finish();
        let _ = std::fs::remove_dir_all(&root);
    }

    #[test]
    fn the_end_of_a_thread_ends_the_run_with_its_name_and_planners_are_told() {
        type Replace = fn(&mut Worker, &Config);
        let replace: [(&str, Replace); 3] = [
            (CHECKPOINTER, |worker, _| worker.checkpointer = panicking()),
            (watch::THREAD, |worker, config| {
                worker.phase =
                    Phase::Leading { files: StandbyFiles::new(config), renewal: panicking() };
            }),
            (PANICS, |worker, _| {
                let thread = panicking();
                worker.needs(thread.watch());
                thread.detach();
            }),
        ];
        for (number, (name, replace)) in replace.into_iter().enumerate() {
            let process = std::process::id();
            let root = format!("/dev/shm/joulebus-test-threads-{process}-{number}");
            let root = std::path::PathBuf::from(root);
            let config = config(&root);
            let domain = config.domain().unwrap();
            let mut worker = Worker::open(&config).unwrap();
            let bus = Bus::join(&domain, "planner").unwrap();
            let mut waiter = bus.planner_waiter(&config.limits()).unwrap();
            replace(&mut worker, &config);
            match worker.run(&AtomicBool::new(false)) {
                Err(RunError::Thread { name: found }) => assert_eq!(found, name),
                other => panic!("{name}: {other:?}"),
            }
            while !waiter.wait_until(None, None).unwrap().ended {}
            // Nothing is lost where nothing else is to be saved.
            assert_eq!(worker.finish().ledger_unsaved, name == CHECKPOINTER, "{name}");
            drop((waiter, bus));
            let _ = std::fs::remove_dir(&root);
            assert!(!root.exists(), "{root:?}");
        }
    }
}
