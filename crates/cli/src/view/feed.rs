//! Reads a fleet's shared memory onto a board, as one more planner.

use std::ops::DerefMut;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context as _;
use joulebus_bus::{Bus, FrameBuf, SampleReader, clock};
use joulebus_config::Config;
use joulebus_consumer::{BudgetFeed, DiagnosticFeed, End, Event, Planner, WorkerState};

use super::board::{Board, Link};

/// How long to wait at most for something to happen.
const PATIENCE: Duration = Duration::from_millis(100);
/// Diagnostics and budgets of a tick follow its forecasts: how long to wait for them.
const FOLLOW_NS: u64 = 5_000_000;
const FOLLOW_EVERY: Duration = Duration::from_micros(200);

/// A planner with everything that it can read. Belongs to the thread that opened it.
pub(crate) struct Reading {
    diagnostics: DiagnosticFeed,
    budgets: BudgetFeed,
    tap: Option<Tap>,
    planner: Planner,
}

impl Reading {
    /// Joins the fleet of `config`; the worker need not be there. With `taps` it also listens to
    /// what the sources send.
    ///
    /// # Errors
    /// When the domain cannot be joined.
    pub(crate) fn open(config: &Config, name: &str, taps: bool) -> anyhow::Result<Self> {
        let planner = Planner::with_config(config, name)?;
        Ok(Self {
            diagnostics: planner.diagnostics()?,
            budgets: planner.budgets()?,
            tap: if taps { Some(Tap::open(config)?) } else { None },
            planner,
        })
    }

    /// Waits for a frame, at most 100 ms; puts what is there on the board, which is borrowed only
    /// after waking up. Returns whether there were forecasts.
    ///
    /// # Errors
    /// When reading has failed in a way that does not mend itself.
    pub(crate) fn turn<B>(&mut self, mut borrow: impl FnMut() -> B) -> anyhow::Result<bool>
    where
        B: DerefMut<Target = Board>,
    {
        let event = self.planner.wait_next(PATIENCE);
        // Before the board, which somebody may be drawing, has to be waited for.
        let readable_ns = clock::monotonic_ns();
        let mut tick = None;
        let mut board = borrow();
        match event {
            Ok(Event::Frame(frame)) => {
                board.forecasts(frame.header(), frame.robots(), readable_ns);
                tick = Some((frame.header().worker_epoch, frame.header().tick));
            }
            Ok(_) => {}
            Err(joulebus_consumer::ReadError::Receive(error)) => {
                board.note(format!("forecasts: {error}"), readable_ns);
            }
            Err(error) => return Err(error.into()),
        }
        board.set_link(link(self.planner.worker()), readable_ns);
        if let Some(tap) = &mut self.tap {
            tap.read(&mut board);
        }
        drop(board);
        if let Some(tick) = tick {
            self.follow(tick, &mut borrow)?;
        }
        Ok(tick.is_some())
    }

    /// Reads the diagnostics and budgets that belong to `tick`, or what there is when they do not
    /// come.
    fn follow<B>(&mut self, tick: (u64, u64), borrow: &mut impl FnMut() -> B) -> anyhow::Result<()>
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
                    board.diagnostics(diagnostics.robots(), now_ns);
                }
                if let Some(budgets) = budgets {
                    board.budgets(budgets.robots());
                }
                return Ok(());
            }
            std::thread::sleep(FOLLOW_EVERY);
        }
    }
}

const fn link(worker: WorkerState) -> Link {
    match worker {
        WorkerState::Waiting => Link::Waiting,
        WorkerState::Alive => Link::Live,
        WorkerState::Stale { .. } => Link::Stale,
        WorkerState::Gone(End::Ended) => Link::Ended,
        // Gone, or a state that only a later version has: nothing to rely on.
        _ => Link::Gone,
    }
}

/// Listens to what the sources send, to know what a killed one had sent.
struct Tap {
    reader: SampleReader,
    frame: FrameBuf,
    // After the port: the order in which they must go.
    _bus: Bus,
}

impl Tap {
    fn open(config: &Config) -> anyhow::Result<Self> {
        let limits = config.limits();
        let bus = Bus::join(&config.domain()?, "tap")?;
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

/// A thread that keeps a board up to date.
pub(crate) struct Feed {
    board: Arc<Mutex<Board>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<anyhow::Result<()>>>,
}

impl Feed {
    /// Starts the thread and waits until it has joined.
    ///
    /// # Errors
    /// When it could not join.
    pub(crate) fn start(config: &Config, name: &'static str, taps: bool) -> anyhow::Result<Self> {
        let board = Arc::new(Mutex::new(Board::new(clock::monotonic_ns())?));
        let stop = Arc::new(AtomicBool::new(false));
        let (ready, started) = std::sync::mpsc::sync_channel(1);
        let (shared, stopped, config) = (Arc::clone(&board), Arc::clone(&stop), config.clone());
        let thread = std::thread::Builder::new()
            .name("joulebus-feed".to_owned())
            .spawn(move || {
                let mut reading = Reading::open(&config, name, taps)?;
                // The starter waits on the other end.
                let _ = ready.send(());
                while !stopped.load(Ordering::Relaxed) {
                    reading.turn(|| lock(&shared))?;
                }
                Ok(())
            })
            .context("cannot start a thread")?;
        let mut feed = Self {
            board,
            stop,
            thread: Some(thread),
        };
        match started.recv() {
            Ok(()) => Ok(feed),
            Err(_) => {
                feed.join()?;
                anyhow::bail!("the planner ended before it had joined")
            }
        }
    }

    /// The board, as it is now.
    pub(crate) fn board(&self) -> MutexGuard<'_, Board> {
        lock(&self.board)
    }

    /// Whether the thread still reads.
    pub(crate) fn is_reading(&self) -> bool {
        self.thread
            .as_ref()
            .is_some_and(|thread| !thread.is_finished())
    }

    /// Leaves the fleet; the board as it was last.
    ///
    /// # Errors
    /// What made the thread end before.
    pub(crate) fn finish(mut self) -> anyhow::Result<Board> {
        self.join()?;
        Ok(self.board().clone())
    }

    fn join(&mut self) -> anyhow::Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => anyhow::bail!("the planner's thread panicked"),
        }
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        // Who wants to know calls `finish`.
        let _ = self.join();
    }
}

fn lock(board: &Mutex<Board>) -> MutexGuard<'_, Board> {
    // A panic elsewhere leaves numbers behind, no broken promise.
    board.lock().unwrap_or_else(PoisonError::into_inner)
}
