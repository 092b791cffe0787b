//! The thread that reads shared memory.
//!
//! It is a planner that reads as often as clients are updated, so that no tick of the worker has to
//! wake it. It never waits for a client. It replaces its results in one place, and the few requests
//! of clients wait in a bounded queue.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use joulebus_board::{Board, Platforms, Reading};
use joulebus_bus::{Background, NoWorker, Rounds, clock, yield_to_the_worker};
use joulebus_config::Config;
use joulebus_connect::ConnectError;
use joulebus_consumer::{AlarmFeed, ReadError, SourceAlarms};
use joulebus_models::load_models;
use joulebus_plan::RobotRows;
use joulebus_program::model_range;
use joulebus_wire::Outlook;
use tokio::sync::watch;

use super::alarms::AlarmLog;
use super::fleet::{Around, Distributions, FleetRecord, Recorder};
use super::history::{self, History, HistoryRecord};
use super::outlooks::OutlookRequests;
use super::plan_rows::{PlanRows, RowsError};
use super::shares::{READINGS, Reply};
use super::snapshot::Snapshot;
use super::totals::Accumulator;

/// Interval between snapshots: as fast as a stream may be.
const SHOW_EVERY: Duration = Duration::from_millis(100);
const SHOW_EVERY_NS: u64 = SHOW_EVERY.as_nanos() as u64;
/// Tolerance of a snapshot's time: it is made at the reading nearest to its due time.
const EARLY_NS: u64 = SHOW_EVERY_NS / 8;
/// Maximum wait while a question needs rows of the next tick.
const ANSWER_EVERY: Duration = Duration::from_millis(10);
/// Interval between distributions, ns.
const DISTRIBUTE_EVERY_NS: u64 = 500_000_000;
/// Nice value of the thread: ahead of the clients' thread, behind the programs that robots wait
/// for.
const NICE: u8 = 5;

/// A client's request to the thread.
#[derive(Debug)]
pub(super) enum Ask {
    History(u32, Reply<Option<HistoryRecord>>),
    Rows(Vec<u32>, Reply<Result<Vec<RobotRows>, RowsError>>),
    /// One robot's, or all robots'.
    Outlooks(Option<u32>, Reply<Vec<Outlook>>),
}

/// Reason that the thread ended.
#[derive(Debug, thiserror::Error)]
pub(super) enum ReaderError {
    #[error(transparent)]
    Connect(#[from] ConnectError),
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error("the reading thread: {0}")]
    Thread(#[from] std::io::Error),
}

pub(super) struct Reader {
    pub(super) snapshots: watch::Receiver<Arc<Snapshot>>,
    pub(super) asks: SyncSender<Ask>,
    /// Takes the processes that record, which another thread looks for.
    pub(super) recorders: watch::Sender<Option<Vec<Recorder>>>,
    thread: Background<Result<(), ReaderError>>,
}

impl Reader {
    /// Joins the fleet and starts to read.
    pub(super) fn start(config: &Config) -> Result<Self, ReaderError> {
        let (asks, asked) = sync_channel(READINGS.all);
        let (recorders, found) = watch::channel(None);
        let config = config.clone();
        let (thread, snapshots) = Background::repeat("joulebus-reader", move || {
            yield_to_the_worker(NICE);
            Work::open(&config, asked, found)
        })?;
        Ok(Self { snapshots, asks, recorders, thread })
    }

    pub(super) fn is_over(&self) -> bool {
        self.thread.has_ended()
    }

    pub(super) fn finish(self) -> Result<(), ReaderError> {
        self.thread.join()
    }
}

/// State of the thread.
struct Work {
    config: Config,
    board: RefCell<Board>,
    reading: Reading,
    alarm_feed: AlarmFeed,
    source_alarms: SourceAlarms,
    alarms: AlarmLog,
    history: History,
    accumulator: Accumulator,
    distributions: Distributions,
    recorders: watch::Receiver<Option<Vec<Recorder>>>,
    platforms: Arc<Platforms>,
    model_warnings: Vec<String>,
    /// What the page says until a frame arrives.
    without_worker: String,
    plan_rows: PlanRows,
    outlooks: OutlookRequests,
    asked: Receiver<Ask>,
    show: watch::Sender<Arc<Snapshot>>,
    show_at_ns: u64,
    distribute_at_ns: u64,
    history_at_ns: u64,
}

impl Work {
    fn open(
        config: &Config,
        asked: Receiver<Ask>,
        recorders: watch::Receiver<Option<Vec<Recorder>>>,
    ) -> Result<(Self, watch::Receiver<Arc<Snapshot>>), ReaderError> {
        let now_ns = clock::monotonic_ns();
        let board = Board::new(now_ns);
        let (mut accumulator, distributions) = (Accumulator::default(), Distributions::default());
        let platforms = Arc::new(Platforms::new(config.settings()));
        let alarms = AlarmLog::default();
        // A model that cannot be loaded is the worker's to report.
        let models = load_models(config).unwrap_or_default();
        let model_warnings = model_range::warnings(config, &models);
        let model_warnings: Vec<String> = model_warnings.iter().map(ToString::to_string).collect();
        let no_worker = config.domain().ok().and_then(|domain| NoWorker::look(&domain));
        let without_worker = match no_worker {
            Some(no_worker) => no_worker.to_string(),
            None => "its worker has just started".to_owned(),
        };
        let around = Around {
            fleet: config.fleet(),
            period_ns: config.tick_period_ns(),
            stale_after_ns: config.worker_stale_after_ns(),
            now_ns,
            now_unix_ns: clock::unix_ns(),
            distributions: &distributions,
            recorders: None,
            model_warnings: &model_warnings,
            without_worker: &without_worker,
        };
        let first = Snapshot::new(
            &board,
            FleetRecord::new(&board, &around),
            alarms.newest(),
            &mut accumulator,
            now_ns,
            Arc::clone(&platforms),
        );
        let (show, snapshots) = watch::channel(Arc::new(first));
        let work = Self {
            reading: Reading::polling(config, "page", SHOW_EVERY)?,
            alarm_feed: AlarmFeed::with_config(config, "page")?,
            source_alarms: SourceAlarms::new(config),
            config: config.clone(),
            board: RefCell::new(board),
            alarms,
            history: History::default(),
            accumulator,
            distributions,
            recorders,
            platforms,
            model_warnings,
            without_worker,
            plan_rows: PlanRows::default(),
            outlooks: OutlookRequests::default(),
            asked,
            show,
            show_at_ns: 0,
            distribute_at_ns: 0,
            history_at_ns: now_ns,
        };
        Ok((work, snapshots))
    }

    fn show(&mut self, now_ns: u64, now_unix_ns: u64) {
        let board = self.board.borrow();
        if now_ns >= self.distribute_at_ns {
            self.distribute_at_ns = now_ns + DISTRIBUTE_EVERY_NS;
            self.distributions = Distributions::new(&board);
        }
        let around = Around {
            fleet: self.config.fleet(),
            period_ns: self.config.tick_period_ns(),
            stale_after_ns: self.config.worker_stale_after_ns(),
            now_ns,
            now_unix_ns,
            distributions: &self.distributions,
            recorders: self.recorders.borrow().clone(),
            model_warnings: &self.model_warnings,
            without_worker: &self.without_worker,
        };
        let snapshot = Snapshot::new(
            &board,
            FleetRecord::new(&board, &around),
            self.alarms.newest(),
            &mut self.accumulator,
            now_ns,
            Arc::clone(&self.platforms),
        );
        self.show.send_replace(Arc::new(snapshot));
    }

    fn answer(&mut self, now_ns: u64) {
        for ask in self.asked.try_iter().take(READINGS.all) {
            match ask {
                Ask::History(robot, reply) => reply.send(self.history.of(robot)),
                Ask::Rows(robots, reply) => self.plan_rows.ask(robots, reply, now_ns),
                Ask::Outlooks(robot, reply) => self.outlooks.ask(robot, reply, now_ns),
            }
        }
        self.plan_rows.poll(self.reading.planner(), now_ns);
        self.outlooks.poll(&mut self.reading, &self.board.borrow(), now_ns);
    }
}

impl Rounds<(), ReaderError> for Work {
    /// Waits until the next look at the fleet is due, at most 100 ms, and does what is due.
    fn round(&mut self) -> Result<Duration, ReaderError> {
        let Self { reading, board, .. } = self;
        let are_asked = self.plan_rows.are_asked() || self.outlooks.are_asked();
        let longest = if are_asked { ANSWER_EVERY } else { SHOW_EVERY };
        reading.poll_within(longest, || board.borrow_mut())?;
        let alarms = &mut self.alarms;
        self.source_alarms.changes(|change| alarms.add(change.into()));
        match self.alarm_feed.changes(|change| alarms.add(change.into())) {
            // The next call may succeed, as with forecasts.
            Ok(()) | Err(ReadError::Receive(_)) => {}
            Err(error) => return Err(error.into()),
        }
        let (now_ns, now_unix_ns) = (clock::monotonic_ns(), clock::unix_ns());
        let unix_of = |at_ns: u64| now_unix_ns.saturating_sub(now_ns.saturating_sub(at_ns));
        let histories = (self.alarm_feed.history(), &self.source_alarms);
        self.alarms.update(histories, unix_of);
        if now_ns >= self.history_at_ns {
            self.history.add(&self.board.borrow(), now_unix_ns);
            // After a long pause points are not made up.
            let next_ns = self.history_at_ns + history::STEP_NS;
            self.history_at_ns = next_ns.max(now_ns);
        }
        if now_ns + EARLY_NS >= self.show_at_ns {
            self.show_at_ns = now_ns + SHOW_EVERY_NS;
            self.show(now_ns, now_unix_ns);
        }
        self.answer(now_ns);
        Ok(Duration::ZERO)
    }

    fn finish(self) -> Result<(), ReaderError> {
        Ok(())
    }
}
