//! The connection of a subscriber to its fleet.

use std::cell::RefCell;
use std::path::Path;
use std::time::Duration;
use std::{fmt, io};

use joulebus_bus::{
    Bus, Limits, OpenError, PeerWatch, Poller, Reader, Readiness, WaitError, Waiter, Woken, clock,
};
use joulebus_config::Config;
use joulebus_connect::{ConnectError, join};
use joulebus_wire::{Channel, Forecast, ForecastHeader};

use crate::frame::{Frame, KeptForecasts};
use crate::index::RobotIndex;
use crate::newest::{ReadError, check_schema, newer};
use crate::tracker::{Lateness, Tracker, order};
use crate::{
    Arrival, Budgets, Counts, Diagnostics, End, Feed, Forecasts, Outlooks, PlanStates, Queries,
    WorkerState,
};

/// A function that is called with each frame.
type Each<'a> = &'a mut dyn FnMut(&ForecastHeader, &[Forecast]);

/// A reader of forecasts: for planners, live views, recorders.
///
/// | method | returns |
/// |---|---|
/// | [`wait_next`](Self::wait_next) | after a wait: the newest frame, or what happened |
/// | [`wait_each`](Self::wait_each) | the same, after a call for each frame since |
/// | [`latest`](Self::latest) | at once: the newest frame, also one returned before |
/// | [`current`](Self::current) | the frame returned last, without looking for another |
/// | [`take_current`](Self::take_current) | the same, to keep: `current` is then `None` |
///
/// [`readiness`](Self::readiness) is for programs that wait for something else as well.
///
/// Stays connected while the worker ends and restarts. Belongs to one thread.
///
/// The [crate](crate)'s page has an example of waiting. A planner with a rhythm of its own takes
/// what is newest:
///
/// ```no_run
/// # use joulebus_consumer::{Subscriber, WorkerState};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut subscriber = Subscriber::connect("configs/fleet.toml")?;
/// subscriber.latest()?;
/// if subscriber.worker() == WorkerState::Alive && let Some(frame) = subscriber.current() {
///     let fleet_w: f32 = frame.iter().filter_map(|robot| robot.expected_w()).sum();
///     println!("the fleet will draw {fleet_w:.0} W");
/// }
/// # Ok(())
/// # }
/// ```
pub struct Subscriber {
    reader: Reader<Forecasts>,
    waiting: Waiting,
    watch: Option<PeerWatch>,
    readiness: Option<Readiness>,
    tracker: Tracker,
    lateness: Lateness,
    arrival: Arrival,
    index: RefCell<RobotIndex>,
    limits: Limits,
    // After the ports, which must be dropped before the process leaves the domain.
    bus: Bus,
}

/// Longest time between two looks.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Longest time between two looks in which nothing that the worker sends to `config`'s fleet is
/// overwritten unread: at most a quarter of what is buffered arrives between them.
pub(crate) fn look_every(config: &Config) -> Duration {
    let frames = config.limits().forecast_frames as u64;
    let buffered_ns = config.tick_period_ns().saturating_mul(frames);
    POLL_INTERVAL.min(Duration::from_nanos(buffered_ns / 4))
}

/// A subscriber's means of waiting.
enum Waiting {
    /// Every tick wakes it.
    Listening(Box<Waiter>),
    Polling(Polling),
}

struct Polling {
    poller: Poller,
    every_ns: u64,
    /// Time of the last look, monotonic ns.
    looked_ns: u64,
}

impl Waiting {
    /// Sleeps until something happens or `until_ns`.
    fn wait_until(
        &mut self,
        until_ns: u64,
        worker: Option<&PeerWatch>,
    ) -> Result<Woken, WaitError> {
        match self {
            Self::Listening(waiter) => waiter.wait_until(Some(until_ns), worker),
            Self::Polling(polling) => {
                let woken = polling.poller.wait_until(until_ns, worker)?;
                polling.looked_ns = clock::monotonic_ns();
                Ok(woken)
            }
        }
    }
}

/// Result of [`Subscriber::wait_next`].
///
/// The [crate](crate)'s page has an example.
#[derive(Debug, Clone, Copy)]
#[must_use]
#[non_exhaustive]
pub enum Event<'a> {
    /// A frame that was not returned before.
    Frame(Frame<'a, Forecasts>),
    /// The worker has ended. This is reported once.
    Gone(End),
    /// The newest frame is older than two tick periods. This is reported once.
    Stale {
        /// Time since it was sent, ns.
        age_ns: u64,
    },
    /// A signal arrived. The program's own handler has run: check whether to exit.
    Interrupted,
    /// No event before the timeout.
    TimedOut,
}

impl Subscriber {
    /// Joins the fleet of the config file at `config_path`, as `planner`. The worker need not run.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn connect(config_path: impl AsRef<Path>) -> Result<Self, ConnectError> {
        Self::with_config(&Config::load(config_path)?, "planner")
    }

    /// Same as [`Subscriber::connect`], with a loaded config, and a name of 1 to 128 bytes. The
    /// name is shown to operators, and need not be unique.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn with_config(config: &Config, name: &str) -> Result<Self, ConnectError> {
        // The waiter before the reader: a frame that arrives in between is found without an event.
        Self::open(config, name, |bus, limits| {
            let waiter = bus.planner_waiter(limits)?;
            Ok(Waiting::Listening(Box::new(waiter)))
        })
    }

    /// Same as [`Subscriber::with_config`], for readers that need forecasts only `every` so often.
    /// It polls, because waking it in every tick would cost the worker time. It looks at least ten
    /// times a second, and so often that nothing is overwritten ([`Subscriber::wait_each`] returns
    /// all frames). It finds the worker's exit at once, and its silence at the next look.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn polling(config: &Config, name: &str, every: Duration) -> Result<Self, ConnectError> {
        let every = every.min(look_every(config));
        Self::open(config, name, |bus, _| {
            Ok(Waiting::Polling(Polling {
                poller: bus.planner_poller(),
                every_ns: every.as_nanos() as u64,
                looked_ns: 0,
            }))
        })
    }

    fn open(
        config: &Config,
        name: &str,
        waiting: impl FnOnce(&Bus, &Limits) -> Result<Waiting, OpenError>,
    ) -> Result<Self, ConnectError> {
        let limits = config.limits();
        let bus = join(config, name)?;
        let waiting = waiting(&bus, &limits)?;
        let reader = bus.reader(&limits)?;
        Ok(Self {
            reader,
            waiting,
            watch: None,
            readiness: None,
            tracker: Tracker::new(),
            lateness: Lateness::new(config.worker_stale_after_ns()),
            arrival: Arrival::default(),
            index: RefCell::default(),
            limits,
            bus,
        })
    }

    /// Longest time between two looks of a polling subscriber. `None` if every tick wakes it.
    pub const fn look_every(&self) -> Option<Duration> {
        match &self.waiting {
            Waiting::Listening(_) => None,
            Waiting::Polling(polling) => Some(Duration::from_nanos(polling.every_ns)),
        }
    }

    /// Waits until there is a frame that was not returned before, the worker ends or is stale, a
    /// signal arrives, or `timeout` is over. It returns the newest of several frames, and counts
    /// those skipped in [`Frame::arrival`]. A frame takes precedence over the other events.
    /// Allocates nothing.
    ///
    /// # Errors
    /// [`ReadError`]. The next call may succeed.
    pub fn wait_next(&mut self, timeout: Duration) -> Result<Event<'_>, ReadError> {
        self.wait(timeout, None)
    }

    /// Waits as [`Subscriber::wait_next`], and calls `each` for every frame since the last call,
    /// oldest first, without skipping any. The event is that of the last one.
    ///
    /// # Errors
    /// [`ReadError`]. The next call may succeed.
    pub fn wait_each(
        &mut self,
        timeout: Duration,
        mut each: impl FnMut(&ForecastHeader, &[Forecast]),
    ) -> Result<Event<'_>, ReadError> {
        self.wait(timeout, Some(&mut each))
    }

    fn wait(
        &mut self,
        timeout: Duration,
        mut each: Option<Each<'_>>,
    ) -> Result<Event<'_>, ReadError> {
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let deadline_ns = clock::monotonic_ns().saturating_add(timeout_ns);
        let mut until_ns = self.first_look_ns().min(deadline_ns);
        loop {
            let woken = self.look(until_ns)?;
            if self.fetch(&mut each)? {
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
            until_ns = deadline_ns.min(self.next_look_ns());
        }
        // `fetch` has found a frame.
        Ok(self.current().map_or(Event::TimedOut, Event::Frame))
    }

    /// The newest frame, without waiting, whether or not it was returned before: its header has the
    /// tick, and [`Subscriber::worker`] shows whether to rely on it. `None` until the first has
    /// arrived. Allocates nothing.
    ///
    /// # Errors
    /// [`ReadError`]. The next call may succeed.
    pub fn latest(&mut self) -> Result<Option<Frame<'_, Forecasts>>, ReadError> {
        self.look(0)?;
        self.fetch(&mut None)?;
        Ok(self.current())
    }

    /// The last frame again.
    pub fn current(&self) -> Option<Frame<'_, Forecasts>> {
        let held = self.reader.held()?;
        let number = self.tracker.counts().frames;
        Some(Frame::new(held, number, &self.index, self.arrival))
    }

    /// Takes the frame of [`Subscriber::current`] out, as [`Option::take`] does, to keep it in
    /// shared memory beyond the next call. There is no current one then until a newer frame
    /// arrives. Two may be kept: with more, reading is an error until one is dropped. A subscriber
    /// that is dropped before keeps its place (`readers.max_planners`) until its frames are dropped.
    #[must_use]
    pub fn take_current(&mut self) -> Option<KeptForecasts> {
        self.reader.take_held().map(KeptForecasts)
    }

    /// A descriptor that is readable when [`Subscriber::wait_next`] is likely to have something to
    /// return, for `epoll`, tokio or mio. It is readable when a frame has arrived or the worker's
    /// process has exited.
    ///
    /// - **When it is readable**, call [`Subscriber::wait_next`] with a timeout of zero until it
    ///   returns [`Event::TimedOut`]. It may return that at once.
    /// - **Call it without readiness as well**, within [`Subscriber::look_within`]. The descriptor
    ///   does not show a silent worker ([`Event::Stale`]) or signals, and may miss a frame that
    ///   arrives while an earlier one is read. For a [polling](Subscriber::polling) subscriber it
    ///   shows the worker's exit only.
    ///
    /// The example `event_loop` of this crate does so with tokio.
    ///
    /// # Errors
    /// The operating system's, when it has no descriptor left.
    pub fn readiness(&mut self) -> io::Result<Readiness> {
        if let Some(readiness) = &self.readiness {
            return Ok(readiness.clone());
        }
        let readiness = match &self.waiting {
            Waiting::Listening(waiter) => Readiness::of(waiter)?,
            Waiting::Polling(_) => Readiness::new()?,
        };
        self.readiness = Some(readiness.clone());
        self.watch_readiness();
        Ok(readiness)
    }

    /// The longest time to wait for [`Subscriber::readiness`] before [`Subscriber::wait_next`] is
    /// called anyway. It is at most 100 ms.
    pub fn look_within(&self) -> Duration {
        let left_ns = self.next_look_ns().saturating_sub(clock::monotonic_ns());
        POLL_INTERVAL.min(Duration::from_nanos(left_ns))
    }

    /// The state of the worker now, as seen by the last call to [`Subscriber::wait_next`] or
    /// [`Subscriber::latest`].
    pub fn worker(&self) -> WorkerState {
        self.tracker.state(match &self.waiting {
            Waiting::Listening(_) => clock::monotonic_ns(),
            // Frames that have arrived since are not known yet.
            Waiting::Polling(polling) => polling.looked_ns,
        })
    }

    /// State of the worker, for people: late only after the config's
    /// `readers.worker_stale_after_s`, and no longer once frames have come for as long.
    pub fn worker_for_people(&mut self) -> WorkerState {
        self.lateness.look(self.worker(), clock::monotonic_ns())
    }

    /// Numbers of frames returned and missed.
    pub const fn counts(&self) -> Counts {
        self.tracker.counts()
    }

    /// Opens a channel that the worker sends.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn feed<C: Channel>(&self) -> Result<Feed<C>, ConnectError> {
        Ok(Feed::new(self.bus.reader(&self.limits)?))
    }

    /// Opens the diagnostics. Frames sent from now on can be read.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn diagnostics(&self) -> Result<Feed<Diagnostics>, ConnectError> {
        self.feed()
    }

    /// Opens the budgets. Frames sent before can be read as soon as the worker sends again, or
    /// updates its connections.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn budgets(&self) -> Result<Feed<Budgets>, ConnectError> {
        self.feed()
    }

    /// Opens what plans start from. The worker sends it while somebody reads it: the first frame
    /// comes with the next tick. `joulebus-plan` computes with it.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn plan_states(&self) -> Result<Feed<PlanStates>, ConnectError> {
        self.feed()
    }

    /// Opens the outlooks: the energy that each robot will draw if it goes on as it does. The
    /// worker computes and sends them while somebody reads them: the first frame comes with the
    /// next tick.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn outlooks(&self) -> Result<Feed<Outlooks>, ConnectError> {
        self.feed()
    }

    /// Opens the records of the worker's questions, whose header counts those answered and refused.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn queries(&self) -> Result<Feed<Queries>, ConnectError> {
        self.feed()
    }

    /// Connections to workers that failed or broke: frames are missing.
    pub fn degraded(&self) -> u64 {
        self.reader.degraded()
    }

    /// Frames of forecasts that another process than the worker has sent: they were passed over.
    pub fn foreign(&self) -> u64 {
        self.reader.foreign()
    }

    /// Should the system have no memory for it, the worker's exit is found at the next look.
    fn watch_readiness(&self) {
        if let (Some(readiness), Some(watch)) = (&self.readiness, &self.watch) {
            let _ = readiness.watch(watch);
        }
    }

    fn first_look_ns(&self) -> u64 {
        match &self.waiting {
            // At once, without sleeping: the event of a waiting frame may have been consumed.
            Waiting::Listening(_) => 0,
            // A known and unreported end does not wait for the next look.
            Waiting::Polling(_) if self.tracker.is_end_unreported() => 0,
            Waiting::Polling(_) => self.next_look_ns(),
        }
    }

    fn next_look_ns(&self) -> u64 {
        match &self.waiting {
            Waiting::Listening(_) => self.tracker.change_due_ns().unwrap_or(u64::MAX),
            Waiting::Polling(polling) => polling.looked_ns.saturating_add(polling.every_ns),
        }
    }

    /// Sleeps until something happens or `until_ns`, and takes note of the worker's end.
    fn look(&mut self, until_ns: u64) -> Result<Woken, ReadError> {
        let woken = self.waiting.wait_until(until_ns, self.watch.as_ref())?;
        let now_ns = clock::monotonic_ns();
        if woken.ended {
            self.tracker.over(End::Ended, now_ns);
        }
        if woken.unreachable {
            self.tracker.over(End::Unreachable, now_ns);
        }
        if woken.peer_gone {
            self.tracker.over(End::Exited, now_ns);
            self.watch = None;
        } else if woken.died && self.watch.is_none() {
            // While the worker's process is watched, the process found dead is another one.
            self.tracker.over(End::FoundDead, now_ns);
        }
        Ok(woken)
    }

    /// Takes the newest frame, and hands those before it to `each`. Returns whether it is new.
    fn fetch(&mut self, each: &mut Option<Each<'_>>) -> Result<bool, ReadError> {
        let (mut at, mut schema) = (self.tracker.order(), None);
        let workers = self.tracker.counts().workers;
        let (tracker, arrival) = (&mut self.tracker, &mut self.arrival);
        let found = self.reader.hold_latest(|header, robots, run| {
            let is_newer = newer(header.schema, order(run, header), &mut at, &mut schema);
            if is_newer && let Some(each) = each.as_mut() {
                *arrival = tracker.frame(run, header, clock::monotonic_ns());
                each(header, robots);
            }
            is_newer
        })?;
        check_schema(found, schema)?;
        let (Some((header, _)), Some((run, ..))) = (self.reader.held().filter(|_| found), at)
        else {
            return Ok(false);
        };
        if each.is_none() {
            // The frames before it were skipped.
            self.arrival = self.tracker.frame(run, header, clock::monotonic_ns());
        }
        if self.tracker.counts().workers != workers {
            // If the pid has been reused meanwhile, the worker is already gone and no fresh frame
            // arrives: the frame's age shows it.
            self.watch = PeerWatch::open(header.pid);
            self.watch_readiness();
            if let Waiting::Polling(polling) = &mut self.waiting {
                polling.poller.watch_worker(header.pid);
            }
        }
        Ok(true)
    }
}

impl fmt::Debug for Subscriber {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Subscriber")
            .field("worker", &self.worker())
            .field("counts", &self.counts())
            .field("limits", &self.limits)
            .finish_non_exhaustive()
    }
}
