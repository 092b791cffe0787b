//! The checkpointer: a thread that reads the worker's own frames, like a planner, and does the work
//! that the tick must not do: it writes the ledger's checkpoints and logs refusals.

use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use joulebus_bus::{Background, Bus, Domain, Reader, Steps, clock};
use joulebus_config::Config;
use joulebus_connect::standby::StandbyFiles;
use joulebus_fleet::StatedBattery;
use joulebus_wire::{Budgets, Diagnostics, DropCounts, DropReason, Forecasts};

use crate::checkpoint::{Checkpoint, SentErrors};
use crate::error::OpenError;
use crate::keyframes::{KeyframeOrders, KeyframeSender};
use crate::ledger_files::{LedgerFileError, LedgerFiles};
use crate::save_schedule::SaveSchedule;
use crate::state_directory::checkpoint_path;

pub(crate) const THREAD: &str = "joulebus-checkpointer";
/// Stated batteries that wait for the checkpointer, at most.
const MAX_STATED: u64 = 64;
/// Maximum sleep of the checkpointer, ns.
const PERIOD_NS: u64 = 200_000_000;
/// Polling interval for a keyframe being sent, ns.
const POLL_EVERY_NS: u64 = PERIOD_NS / 10;
/// Interval between two logs of refusals, or of saves that failed, ns.
const LOG_EVERY_NS: u64 = 5 * PERIOD_NS;
/// Accounts in the ledger per robot of the fleet's capacity: as many again for departed robots.
const ACCOUNTS_PER_ROBOT: usize = 2;

/// Batteries that persons have stated of robots without a budget, on their way to the ledger.
#[derive(Debug)]
pub(crate) struct StatedBatteries {
    to: SyncSender<StatedBattery>,
    sent: u64,
    taken: Arc<AtomicU64>,
}

impl StatedBatteries {
    /// The two ends for the checkpointer.
    pub(crate) fn channel() -> (Self, Receiver<StatedBattery>, Arc<AtomicU64>) {
        let (to, from) = sync_channel(MAX_STATED as usize);
        let taken = Arc::<AtomicU64>::default();
        (Self { to, sent: 0, taken: Arc::clone(&taken) }, from, taken)
    }

    pub(crate) fn has_room(&self) -> bool {
        self.sent - self.taken.load(Ordering::Relaxed) < MAX_STATED
    }

    /// Sends one, if there is room.
    pub(crate) fn send(&mut self, stated: StatedBattery) {
        self.sent += u64::from(self.to.try_send(stated).is_ok());
    }
}

/// Failures of the worker's loop, counted there and logged by the checkpointer.
#[derive(Debug, Default)]
pub(crate) struct Failures {
    pub unsent: AtomicU64,
    pub receive: AtomicU64,
    /// Ticks without diagnostics.
    pub shed: AtomicU64,
    /// The ledger could not be saved when it was tried last.
    pub unsaved: AtomicBool,
}

/// What the checkpointer shares with the worker.
pub(crate) struct WorkerEnds {
    pub(crate) failures: Arc<Failures>,
    pub(crate) errors: Arc<SentErrors>,
    pub(crate) orders: KeyframeOrders,
    pub(crate) stated: Receiver<StatedBattery>,
    /// Number of stated batteries that the checkpointer has taken.
    pub(crate) taken: Arc<AtomicU64>,
}

/// Starts the checkpointer and waits until it reads. `before`: the ledger of an earlier run and its
/// location. Its last step writes the last checkpoint.
pub(crate) fn start(
    domain: &Domain,
    config: &Config,
    before: SavedLedger,
    ends: WorkerEnds,
) -> Result<Background, OpenError> {
    let (domain, config) = (domain.clone(), config.clone());
    Background::start(THREAD, move || Checkpointer::open(&domain, &config, before, ends))
}

struct Checkpointer {
    // Before the bus, because ports must be dropped first.
    budgets: Reader<Budgets>,
    diagnostics: Reader<Diagnostics>,
    forecasts: Reader<Forecasts>,
    keyframes: KeyframeSender,
    _bus: Bus,
    failures: Arc<Failures>,
    errors: Arc<SentErrors>,
    stated: Receiver<StatedBattery>,
    taken: Arc<AtomicU64>,
    checkpoint: Checkpoint,
    /// None if the ledger is not saved.
    files: Option<LedgerFiles>,
    max_accounts: usize,
    /// Ids of the robots that the config names, and their periods, ns.
    robots: Vec<(RangeInclusive<u32>, u64)>,
    schedule: SaveSchedule,
    changed: bool,
    drops: DropCounts,
    failed: (u64, u64),
    shed: u64,
    sheds: bool,
    /// When the next lines are logged, monotonic ns.
    log_ns: u64,
    /// Time of the next log of a failing save, monotonic ns. It is tried several times a second.
    next_log_ns: u64,
}

impl Checkpointer {
    fn open(
        domain: &Domain,
        config: &Config,
        SavedLedger { checkpoint, files }: SavedLedger,
        WorkerEnds { failures, errors, orders, stated, taken }: WorkerEnds,
    ) -> Result<Self, OpenError> {
        let bus = Bus::join(domain, "checkpointer")?;
        let limits = config.limits();
        let every_ns = files.as_ref().map(|_| config.checkpoint_every_ns());
        let now_ns = clock::monotonic_ns();
        let saved = checkpoint.robots.len();
        Ok(Self {
            budgets: bus.reader(&limits)?,
            diagnostics: bus.reader(&limits)?,
            forecasts: bus.reader(&limits)?,
            keyframes: KeyframeSender::open(
                &bus,
                &limits,
                config.settings(),
                orders,
                StandbyFiles::new(config).keyframe,
            )?,
            _bus: bus,
            failures,
            errors,
            stated,
            taken,
            checkpoint,
            files,
            // A capacity that is lowered takes no account.
            max_accounts: (limits.capacity.saturating_mul(ACCOUNTS_PER_ROBOT)).max(saved),
            robots: config
                .settings()
                .platforms
                .iter()
                .flat_map(|of| of.robots.iter().map(|ids| (ids.clone(), of.period_ns)))
                .collect(),
            schedule: SaveSchedule::new(every_ns.unwrap_or(u64::MAX), now_ns),
            changed: false,
            drops: DropCounts::default(),
            failed: (0, 0),
            shed: 0,
            sheds: false,
            log_ns: 0,
            next_log_ns: 0,
        })
    }

    /// Reads the budgets, then takes the statements that were there before: what was sent before a
    /// statement is known when it is taken.
    fn read(&mut self) {
        let stated: Vec<StatedBattery> = self.stated.try_iter().collect();
        self.read_budgets();
        for stated in &stated {
            self.checkpoint.state(stated);
            self.changed = true;
            self.taken.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn read_budgets(&mut self) {
        let (checkpoint, most) = (&mut self.checkpoint, self.max_accounts);
        let robots = &self.robots;
        let period_ns = |robot| {
            robots.iter().find(|(ids, _)| ids.contains(&robot)).map(|(_, period_ns)| *period_ns)
        };
        let (mut gone, mut changed) = (0, false);
        // Not the newest alone: of a worker that was stopped for long, robots that have left are in
        // the one before.
        let read = self.budgets.take_all(|header, budgets| {
            for robot in checkpoint.exchanged(budgets) {
                tracing::info!(robot, "the robot has another battery");
            }
            gone += checkpoint.take(header, budgets, (most, period_ns));
            changed = true;
        });
        self.changed |= changed;
        if gone > 0 {
            let allowed = self.max_accounts;
            tracing::warn!(
                gone,
                allowed,
                "more robots than accounts: the accounts of robots that left long ago are given \
                 up. Their batteries are unknown until measured or full"
            );
        }
        if let Err(error) = read {
            tracing::warn!(%error, "the checkpointer cannot read budgets");
        }
    }

    fn save(&mut self) {
        let begun_ns = clock::monotonic_ns();
        let of_ns = self.checkpoint.written_ns;
        let Some(files) = self.files.as_mut().filter(|_| self.changed) else {
            // There is nothing newer than the saved state.
            self.schedule.tried(begun_ns, (begun_ns, begun_ns), true);
            return;
        };
        self.checkpoint.errors = self.errors.receive();
        let saved = files.write(&self.checkpoint);
        if let Err(error) = &saved
            && begun_ns >= self.next_log_ns
        {
            self.next_log_ns = begun_ns.saturating_add(LOG_EVERY_NS);
            tracing::error!(%error, "the ledger was not saved");
        }
        self.changed = saved.is_err();
        self.failures.unsaved.store(self.changed, Ordering::Relaxed);
        let ended_ns = clock::monotonic_ns();
        let times = (begun_ns, ended_ns);
        let late = self.schedule.tried(of_ns, times, saved.is_ok());
        if let Some(exposed_ns) = late.filter(|_| saved.is_ok()) {
            let (took_ms, exposed_ms) = ((ended_ns - begun_ns) / 1_000_000, exposed_ns / 1_000_000);
            tracing::warn!(
                exposed_ms,
                took_ms,
                "the ledger was saved later than `ledger.every_s` says: the disk or the machine is too slow"
            );
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
            tracing::warn!(unsent = failed.0, receive = failed.1, "frames failed so far");
            self.failed = failed;
        }
        self.log_shed();
    }

    /// Logs one line when diagnostics are omitted for the first time, and one when they resume.
    fn log_shed(&mut self) {
        let before = std::mem::replace(&mut self.shed, self.failures.shed.load(Ordering::Relaxed));
        let (ticks, more) = (self.shed, self.shed > before);
        match (more, self.sheds) {
            (true, false) => tracing::warn!(
                ticks,
                "ticks take longer than their period: diagnostics are left out"
            ),
            (false, true) => {
                tracing::info!(ticks, "ticks are within their period again: diagnostics resume");
            }
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

impl Steps for Checkpointer {
    fn step(&mut self, last: bool) -> Option<Duration> {
        self.read();
        let now_ns = clock::monotonic_ns();
        if last || now_ns >= self.schedule.next_ns() {
            self.save();
        }
        if last || now_ns >= self.log_ns {
            self.log_ns = now_ns.saturating_add(LOG_EVERY_NS);
            self.log();
        }
        if last {
            return None;
        }
        self.keyframes.poll();
        let pause_ns = if self.keyframes.is_busy() { POLL_EVERY_NS } else { PERIOD_NS };
        let due_ns = self.schedule.next_ns();
        let due_ns = due_ns.saturating_sub(clock::monotonic_ns());
        Some(Duration::from_nanos(pause_ns.min(due_ns)))
    }
}

/// The ledger of an earlier run, and the location for the next save.
#[derive(Debug)]
pub(crate) struct SavedLedger {
    pub(crate) checkpoint: Checkpoint,
    files: Option<LedgerFiles>,
}

/// The ledger of an earlier run of this fleet, converted to the current boot.
pub(crate) fn read_ledger(config: &Config) -> Result<SavedLedger, LedgerFileError> {
    let io =
        |source| LedgerFileError::Io { path: "/proc/sys/kernel/random/boot_id".into(), source };
    let boot_id = clock::boot_id().map_err(io)?;
    let path = checkpoint_path(config);
    let mut files = path.as_deref().map(LedgerFiles::new);
    let read = match &mut files {
        Some(files) => {
            let read = files.read(config.fleet())?;
            if let Err(error) = files.secure() {
                tracing::warn!(%error, "until the next save, a power failure may undo the last \
                    save");
            }
            read
        }
        None => None,
    };
    let before = read.unwrap_or_else(|| Checkpoint::new(config.fleet(), &boot_id));
    let checkpoint = before.carried_over(&boot_id, clock::monotonic_ns(), clock::unix_ns());
    Ok(SavedLedger { checkpoint, files })
}
