//! Feeds a board from a fleet's shared memory, as a planner.

use std::fmt;
use std::ops::DerefMut;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use joulebus_bus::{Background, Bus, FrameBuf, Rounds, SampleReader, clock};
use joulebus_config::Config;
use joulebus_connect::raises::raises;
use joulebus_connect::refusals::Refusals;
use joulebus_connect::{ConnectError, join};
use joulebus_consumer::{
    self as consumer, Budgets, Diagnostics, End, Outlooks, Queries, ReadError, Subscriber,
    WorkerState,
};
use joulebus_wire::Acknowledgements;

use crate::board::{Board, Link};

/// Timeout of one wait.
const WAIT_TIMEOUT: Duration = Duration::from_millis(100);
/// Interval of reading what the worker refuses, ns.
const REFUSALS_EVERY_NS: u64 = 1_000_000_000;
/// Timeout for the diagnostics and budgets of a tick, which follow its forecasts.
const FOLLOW_NS: u64 = 5_000_000;
const FOLLOW_EVERY: Duration = Duration::from_micros(200);

/// Reason that the thread of a [`Feed`] does not read, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum FeedError {
    /// The fleet cannot be joined.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// Reading fails permanently.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// There is no thread for it, or it panicked.
    #[error("the planner's thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// A planner with all its readers. Belongs to the thread that opened it.
pub struct Reading {
    diagnostics: consumer::Feed<Diagnostics>,
    budgets: consumer::Feed<Budgets>,
    /// None while nobody wants them: the worker computes them only for readers.
    outlooks: Option<consumer::Feed<Outlooks>>,
    queries: consumer::Feed<Queries>,
    /// None if there are too many readers.
    acknowledgements: Option<consumer::Feed<Acknowledgements>>,
    tap: Option<Tap>,
    polls: bool,
    config: Config,
    knows_raises: bool,
    refusals_ns: u64,
    planner: Subscriber,
}

impl Reading {
    /// Joins the fleet of `config`. No worker needs to run. With `taps` it also reads the frames of
    /// the sources.
    ///
    /// # Errors
    /// The domain cannot be joined.
    pub fn open(config: &Config, name: &str, taps: bool) -> Result<Self, ConnectError> {
        let mut reading = Self::new(Subscriber::with_config(config, name)?, config)?;
        if taps {
            reading.tap = Some(Tap::open(config)?);
        }
        Ok(reading)
    }

    /// Same as [`Reading::open`], for boards that are read only `every` so often. Ticks do not wake
    /// it, as in [`Subscriber::polling`]. No frame of forecasts is skipped. They count as readable
    /// when they are sent, because the worker does not cause the time until the next reading.
    ///
    /// # Errors
    /// The domain cannot be joined.
    pub fn polling(config: &Config, name: &str, every: Duration) -> Result<Self, ConnectError> {
        let reading = Self::new(Subscriber::polling(config, name, every)?, config)?;
        Ok(Self { polls: true, ..reading })
    }

    fn new(planner: Subscriber, config: &Config) -> Result<Self, ConnectError> {
        Ok(Self {
            diagnostics: planner.diagnostics()?,
            budgets: planner.budgets()?,
            outlooks: None,
            queries: planner.queries()?,
            acknowledgements: planner.feed().ok(),
            tap: None,
            polls: false,
            config: config.clone(),
            knows_raises: false,
            refusals_ns: 0,
            planner,
        })
    }

    /// Waits at most 100 ms for a frame and adds all available data to the board, which is borrowed
    /// only after the wait. Returns true if there were forecasts.
    ///
    /// # Errors
    /// Reading fails permanently.
    pub fn poll<B>(&mut self, borrow: impl FnMut() -> B) -> Result<bool, ReadError>
    where
        B: DerefMut<Target = Board>,
    {
        self.poll_within(WAIT_TIMEOUT, borrow)
    }

    /// Same as [`Reading::poll`], with another maximum wait.
    ///
    /// # Errors
    /// Reading fails permanently.
    pub fn poll_within<B>(
        &mut self,
        longest: Duration,
        mut borrow: impl FnMut() -> B,
    ) -> Result<bool, ReadError>
    where
        B: DerefMut<Target = Board>,
    {
        let (polls, mut tick) = (self.polls, None);
        let waited = self.planner.wait_each(longest, |header, robots| {
            // Before the wait for the board, which may be locked for drawing.
            let readable_ns = if polls { header.sent_ns } else { clock::monotonic_ns() };
            borrow().forecasts(header, robots, readable_ns);
            tick = Some((header.worker_epoch, header.tick));
        });
        let now_ns = clock::monotonic_ns();
        let waited = waited.map(drop);
        let mut board = borrow();
        match waited {
            Ok(()) => {}
            Err(ReadError::Receive(error)) => board.note(format!("forecasts: {error}"), now_ns),
            Err(error) => return Err(error),
        }
        board.set_link(link(self.planner.worker_for_people()), now_ns);
        board.is_reliable = self.planner.worker() == WorkerState::Alive;
        if let Some(tap) = &mut self.tap {
            tap.read(&mut board);
        }
        if now_ns >= self.refusals_ns {
            self.refusals_ns = now_ns + REFUSALS_EVERY_NS;
            board.refused(Refusals::read(&self.config), now_ns);
        }
        if let Ok(Some(frame)) = self.queries.latest() {
            board.queries = Some(frame.header().counts);
        }
        if let Some(Ok(Some(frame))) = self.acknowledgements.as_mut().map(consumer::Feed::latest) {
            board.acknowledged(frame.robots());
        }
        drop(board);
        if let Some(tick) = tick {
            self.follow(tick, &mut borrow)?;
        }
        Ok(tick.is_some())
    }

    /// Begins or ceases to read outlooks. The board has them from the next ticks on.
    ///
    /// # Errors
    /// There are too many readers.
    pub fn want_outlooks(&mut self, wanted: bool) -> Result<(), ConnectError> {
        match (wanted, &self.outlooks) {
            (true, None) => self.outlooks = Some(self.planner.outlooks()?),
            (false, Some(_)) => self.outlooks = None,
            _ => {}
        }
        Ok(())
    }

    /// The planner, for further feeds of the same fleet.
    pub const fn planner(&self) -> &Subscriber {
        &self.planner
    }

    /// Reads the diagnostics and budgets of `tick`, or the available ones if these do not arrive.
    fn follow<B>(
        &mut self,
        tick: (u64, u64),
        borrow: &mut impl FnMut() -> B,
    ) -> Result<(), ReadError>
    where
        B: DerefMut<Target = Board>,
    {
        let give_up_ns = clock::monotonic_ns() + FOLLOW_NS;
        loop {
            let now_ns = clock::monotonic_ns();
            let diagnostics = self.diagnostics.latest()?;
            let budgets = self.budgets.latest()?;
            let diagnosed = diagnostics
                .as_ref()
                .is_some_and(|frame| (frame.header().worker_epoch, frame.header().tick) >= tick);
            let budgeted = budgets
                .as_ref()
                .is_some_and(|frame| (frame.header().worker_epoch, frame.header().tick) >= tick);
            if (diagnosed && budgeted) || now_ns >= give_up_ns {
                let mut board = borrow();
                if let Some(diagnostics) = diagnostics {
                    if !std::mem::replace(&mut self.knows_raises, true) {
                        let run = diagnostics.header().worker_epoch;
                        board.know_raises(raises(&self.config, run));
                        let platforms = self.config.settings().platforms.iter();
                        board.name_platforms(platforms.map(|one| one.name.clone()).collect());
                    }
                    board.memories(&diagnostics.header().platforms, now_ns);
                    board.diagnostics(diagnostics.robots(), now_ns);
                }
                if let Some(budgets) = budgets {
                    board.budgets(budgets.robots());
                }
                // They are sent right after the budgets. Those of the tick before may be found.
                match self.outlooks.as_mut().map(consumer::Feed::latest) {
                    None => board.outlooks.clear(),
                    Some(found) => {
                        found?.into_iter().for_each(|outlooks| board.outlooks(outlooks.robots()));
                    }
                }
                return Ok(());
            }
            clock::sleep(FOLLOW_EVERY);
        }
    }
}

impl fmt::Debug for Reading {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Reading").field("planner", &self.planner).finish_non_exhaustive()
    }
}

const fn link(worker: WorkerState) -> Link {
    match worker {
        WorkerState::Waiting => Link::Waiting,
        WorkerState::Alive => Link::Live,
        WorkerState::Stale { .. } => Link::Stale,
        WorkerState::Gone(End::Ended) => Link::Ended,
        // Gone, or a state of a later version: not reliable.
        _ => Link::Gone,
    }
}

/// Reads the sources' frames to know what a killed source had sent.
struct Tap {
    reader: SampleReader,
    frame: FrameBuf,
    // Dropped after the port.
    _bus: Bus,
}

impl Tap {
    fn open(config: &Config) -> Result<Self, ConnectError> {
        let limits = config.limits();
        let bus = join(config, "tap")?;
        Ok(Self {
            reader: bus.sample_reader(&limits)?,
            frame: FrameBuf::new(limits.capacity),
            _bus: bus,
        })
    }

    fn read(&mut self, board: &mut Board) {
        // A failure shows as samples that are not accounted for.
        while let Ok(true) = self.reader.take(&mut self.frame) {
            let header = self.frame.header();
            let here = self.frame.samples().len() + self.frame.truncated();
            let samples = header.samples_before.saturating_add(here as u64);
            board.source_sent(header.source_epoch, samples);
        }
    }
}

/// State of the thread of a [`Feed`].
struct Feeding {
    reading: Reading,
    board: Arc<Mutex<Board>>,
}

impl Rounds<(), FeedError> for Feeding {
    fn round(&mut self) -> Result<Duration, FeedError> {
        self.reading.poll(|| lock(&self.board))?;
        Ok(Duration::ZERO)
    }

    fn finish(self) -> Result<(), FeedError> {
        Ok(())
    }
}

/// A thread that keeps a board up to date.
#[derive(Debug)]
pub struct Feed {
    board: Arc<Mutex<Board>>,
    thread: Background<Result<(), FeedError>>,
}

impl Feed {
    /// Starts the thread and waits until it has joined the fleet. With `taps` it also reads the
    /// frames of the sources, with `outlooks` those.
    ///
    /// # Errors
    /// The thread cannot join.
    pub fn start(
        config: &Config,
        name: &'static str,
        (taps, outlooks): (bool, bool),
    ) -> Result<Self, FeedError> {
        let board = Arc::new(Mutex::new(Board::new(clock::monotonic_ns())));
        let (shared, config) = (Arc::clone(&board), config.clone());
        let (thread, ()) = Background::repeat("joulebus-feed", move || {
            let mut reading = Reading::open(&config, name, taps)?;
            reading.want_outlooks(outlooks)?;
            Ok((Feeding { reading, board: shared }, ()))
        })?;
        Ok(Self { board, thread })
    }

    /// The current board.
    pub fn board(&self) -> MutexGuard<'_, Board> {
        lock(&self.board)
    }

    /// True if the thread still reads.
    pub fn is_reading(&self) -> bool {
        !self.thread.has_ended()
    }

    /// Leaves the fleet and returns the last board.
    ///
    /// # Errors
    /// The error that ended the thread.
    pub fn finish(self) -> Result<Board, FeedError> {
        self.thread.join()?;
        Ok(lock(&self.board).clone())
    }
}

fn lock(board: &Mutex<Board>) -> MutexGuard<'_, Board> {
    // A panic elsewhere leaves the board consistent.
    board.lock().unwrap_or_else(PoisonError::into_inner)
}
