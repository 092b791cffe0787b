//! The connection of a planner to its fleet.

use std::cell::RefCell;
use std::fmt;
use std::path::Path;
use std::time::Duration;

use joulebus_bus::{Bus, ForecastReader, Limits, OpenError, PeerWatch, Waiter, Woken, clock};
use joulebus_config::{Config, ConnectError};
use joulebus_wire::{BudgetHeader, DiagnosticHeader, Forecast};

use crate::frame::Frame;
use crate::index::RobotIndex;
use crate::newest::{ReadError, check_schema, newer};
use crate::tracker::{Tracker, place};
use crate::{Arrival, BudgetFeed, Counts, DiagnosticFeed, End, Forecasts, WorkerState};

/// A reader of forecasts: a planner, a watcher, a recorder.
///
/// Stays connected while the worker goes and comes. Belongs to one thread.
pub struct Planner {
    reader: ForecastReader,
    waiter: Waiter,
    watch: Option<PeerWatch>,
    tracker: Tracker,
    arrival: Arrival,
    index: RefCell<RobotIndex>,
    limits: Limits,
    // After the ports: it must be gone before the process leaves.
    bus: Bus,
}

/// What [`Planner::wait_next`] has waited for.
#[derive(Debug, Clone, Copy)]
#[must_use]
#[non_exhaustive]
pub enum Event<'a> {
    /// A frame that was not given before.
    Frame(Forecasts<'a>),
    /// The worker is gone; told once.
    Gone(End),
    /// The newest frame has become older than two tick periods; told once.
    Stale {
        /// Time since it was sent, ns.
        age_ns: u64,
    },
    /// A signal came. The program's own handler has run: time to look whether it is to end.
    Interrupted,
    /// Nothing of it happened in time.
    TimedOut,
}

impl Planner {
    /// Joins the fleet of the config file at `config_path`, as `planner`. The worker need not run.
    ///
    /// # Errors
    /// [`ConnectError`] says what is in the way and what to do.
    pub fn connect(config_path: impl AsRef<Path>) -> Result<Self, ConnectError> {
        Self::with_config(&Config::load(config_path)?, "planner")
    }

    /// As [`Planner::connect`], with a config that has been read, and a name of 1 to 128 bytes
    /// that operators see; several may have the same.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn with_config(config: &Config, name: &str) -> Result<Self, ConnectError> {
        let limits = config.limits();
        let bus = config.join(name)?;
        // The waiter first: a frame that comes in between is found without an event.
        let waiter = bus.planner_waiter(&limits)?;
        let reader = bus.forecast_reader(&limits)?;
        Ok(Self {
            reader,
            waiter,
            watch: None,
            tracker: Tracker::new(),
            arrival: Arrival::default(),
            index: RefCell::default(),
            limits,
            bus,
        })
    }

    /// Waits until there is a frame that was not given before, the worker goes or falls silent, a
    /// signal comes, or `timeout` is over. Of several frames it gives the newest; those passed over
    /// are in [`Forecasts::arrival`]. A frame comes before bad news. Allocates nothing.
    ///
    /// # Errors
    /// [`ReadError`]; the next call may succeed.
    pub fn wait_next(&mut self, timeout: Duration) -> Result<Event<'_>, ReadError> {
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let deadline_ns = clock::monotonic_ns().saturating_add(timeout_ns);
        // Looks first, without sleeping: the event of a frame that waits may have been taken.
        let mut until_ns = 0;
        loop {
            let woken = self.look(until_ns)?;
            if self.fetch()? {
                break;
            }
            let now_ns = clock::monotonic_ns();
            match self.tracker.change(now_ns) {
                Some(WorkerState::Gone(end)) => return Ok(Event::Gone(end)),
                Some(WorkerState::Stale { age_ns }) => return Ok(Event::Stale { age_ns }),
                _ => {}
            }
            if woken.interrupted {
                return Ok(Event::Interrupted);
            }
            if now_ns >= deadline_ns {
                return Ok(Event::TimedOut);
            }
            until_ns = deadline_ns.min(self.tracker.change_due_ns().unwrap_or(u64::MAX));
        }
        // `fetch` has found a frame, so there is one.
        Ok(self.current().map_or(Event::TimedOut, Event::Frame))
    }

    /// The newest frame, without waiting, whether or not it was given before: its header tells the
    /// tick, [`Planner::worker`] whether to rely on it. `None` until the first has come. Allocates
    /// nothing.
    ///
    /// # Errors
    /// [`ReadError`]; the next call may succeed.
    pub fn latest(&mut self) -> Result<Option<Forecasts<'_>>, ReadError> {
        self.look(0)?;
        self.fetch()?;
        Ok(self.current())
    }

    /// The frame that was given last, once more.
    #[must_use]
    pub fn current(&self) -> Option<Forecasts<'_>> {
        let held = self.reader.held()?;
        let number = self.tracker.counts().frames;
        let id = |row: &Forecast| row.robot;
        Some(Frame::new(held, number, id, &self.index, self.arrival))
    }

    /// How the worker stands at this moment, as far as the last call to [`Planner::wait_next`] or
    /// [`Planner::latest`] has seen.
    #[must_use]
    pub fn worker(&self) -> WorkerState {
        self.tracker.state(clock::monotonic_ns())
    }

    /// What has been given so far, and missed.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.tracker.counts()
    }

    /// Opens the diagnostics. Frames that are sent from now on can be read.
    ///
    /// # Errors
    /// [`OpenError`] says what is in the way and what to do.
    pub fn diagnostics(&self) -> Result<DiagnosticFeed, OpenError> {
        let reader = self.bus.diagnostic_reader(&self.limits)?;
        let of_header =
            |header: &DiagnosticHeader| (header.schema, header.worker_epoch, header.tick);
        Ok(DiagnosticFeed::new(reader, of_header, |row| row.robot))
    }

    /// Opens the budgets. What was sent before can be read as soon as the worker sends again, or
    /// looks for newcomers.
    ///
    /// # Errors
    /// [`OpenError`] says what is in the way and what to do.
    pub fn budgets(&self) -> Result<BudgetFeed, OpenError> {
        let reader = self.bus.budget_reader(&self.limits)?;
        let of_header = |header: &BudgetHeader| (header.schema, header.worker_epoch, header.tick);
        Ok(BudgetFeed::new(reader, of_header, |row| row.robot))
    }

    /// Connections to workers that could not be made, or broke: frames are missing.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.reader.degraded()
    }

    /// Frames of forecasts that another process than the worker has sent: they were passed over.
    #[must_use]
    pub fn foreign(&self) -> u64 {
        self.reader.foreign()
    }

    /// Sleeps until something happens or `until_ns`, and takes note of the worker's end.
    fn look(&mut self, until_ns: u64) -> Result<Woken, ReadError> {
        let woken = self
            .waiter
            .wait_until(Some(until_ns), self.watch.as_ref())?;
        let now_ns = clock::monotonic_ns();
        if woken.ended {
            self.tracker.over(End::Ended, now_ns);
        }
        if woken.peer_gone {
            self.tracker.over(End::Exited, now_ns);
            self.watch = None;
        } else if woken.died && self.watch.is_none() {
            // While the worker's process is watched, it is another one that was found dead.
            self.tracker.over(End::FoundDead, now_ns);
        }
        Ok(woken)
    }

    /// Holds the newest frame; whether it is a new one.
    fn fetch(&mut self) -> Result<bool, ReadError> {
        let (mut at, mut schema) = (self.tracker.place(), None);
        let found = self.reader.hold_latest(|header, run| {
            newer(header.schema, place(run, header), &mut at, &mut schema)
        })?;
        check_schema(found, schema)?;
        let (Some((header, _)), Some((run, ..))) = (self.reader.held().filter(|_| found), at)
        else {
            return Ok(false);
        };
        let first = self.tracker.place().is_none();
        self.arrival = self.tracker.frame(run, header);
        if first || self.arrival.restarted {
            // Should the pid have gone to another process meanwhile, then the worker is gone
            // already and no fresh frame comes: the frame's age tells.
            self.watch = PeerWatch::open(header.pid);
        }
        Ok(true)
    }
}

impl fmt::Debug for Planner {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Planner")
            .field("worker", &self.worker())
            .field("counts", &self.counts())
            .field("limits", &self.limits)
            .finish_non_exhaustive()
    }
}
