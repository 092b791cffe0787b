//! Changes of all alarms of a fleet: those of its robots, and those of its worker.

use std::fmt;

use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_connect::ConnectError;
use joulebus_wire::{Acknowledgement, AlarmCard, Level};

use crate::{
    AlarmChange, AlarmFeed, AlarmHistory, Change, ReadError, SourceAlarms, SourceChange,
    Subscriber, WorkerState,
};

/// A raise or an end of an alarm, of a robot or of the worker. [`FleetAlarms`] passes them on.
///
/// ```
/// use joulebus_consumer::wire::{AlarmCard, Level};
/// use joulebus_consumer::{Change, FleetAlarm};
///
/// let raised = FleetAlarm::new(None, &AlarmCard::WORKER_STALE, Change::Raised, 2_000_000_000);
/// assert_eq!((raised.level, raised.lasted_s()), (Level::Stale, None));
/// let mut cleared = raised;
/// (cleared.change, cleared.at_ns) = (Change::Cleared, 5_500_000_000);
/// assert_eq!(cleared.lasted_s(), Some(3.5));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct FleetAlarm {
    /// The robot. `None` for the worker.
    pub robot: Option<u32>,
    /// Name of the [`joulebus_wire::Alarm`], or `Implausible` for an alarm of a source. Alarms of
    /// the worker are `WorkerGone` and `WorkerStale`. [`AlarmCard::named`] has its meaning.
    pub alarm: &'static str,
    /// Its level.
    pub level: Level,
    /// The change.
    pub change: Change,
    /// When, monotonic ns.
    pub at_ns: u64,
    /// When it was raised, monotonic ns, also if that was before this program began. If that is not
    /// known, when the program first saw it: an alarm of the worker or of a source, and one on a
    /// host that a link joins.
    pub raised_ns: u64,
    /// The acknowledgement since it was raised.
    pub acknowledged: Option<Acknowledgement>,
}

impl FleetAlarm {
    /// A change of the card's alarm at `at_ns`, raised then too and not acknowledged.
    #[must_use]
    pub const fn new(robot: Option<u32>, card: &AlarmCard, change: Change, at_ns: u64) -> Self {
        let (alarm, level) = (card.name, card.level);
        Self { robot, alarm, level, change, at_ns, raised_ns: at_ns, acknowledged: None }
    }

    /// From the raise to the end, s. `None` while it is raised.
    pub fn lasted_s(&self) -> Option<f64> {
        let lasted_ns = self.at_ns.saturating_sub(self.raised_ns);
        matches!(self.change, Change::Cleared | Change::Left).then_some(lasted_ns as f64 * 1e-9)
    }
}

impl From<AlarmChange> for FleetAlarm {
    fn from(change: AlarmChange) -> Self {
        Self {
            robot: Some(change.robot),
            alarm: change.alarm.name(),
            level: change.alarm.level(),
            change: change.change,
            at_ns: change.at_ns,
            raised_ns: change.raised_ns,
            acknowledged: change.acknowledged,
        }
    }
}

impl From<SourceChange> for FleetAlarm {
    fn from(change: SourceChange) -> Self {
        let SourceChange { robot, change, at_ns, raised_ns } = change;
        Self { raised_ns, ..Self::new(Some(robot), &AlarmCard::IMPLAUSIBLE, change, at_ns) }
    }
}

/// An alarm of the worker itself, and since when, monotonic ns.
type OfWorker = (AlarmCard, u64);

/// All alarms of a running fleet. Belongs to the thread that connected it.
///
/// ```no_run
/// use joulebus_consumer::{Config, FleetAlarms};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut alarms = FleetAlarms::with_config(&Config::load("configs/fleet.toml")?, "pager")?;
/// loop {
///     alarms.wait(|alarm| match alarm.robot {
///         Some(robot) => println!("{} of robot {robot}: {}", alarm.alarm, alarm.change.name()),
///         None => println!("{} of the worker: {}", alarm.alarm, alarm.change.name()),
///     })?;
/// }
/// # }
/// ```
pub struct FleetAlarms {
    subscriber: Subscriber,
    feed: AlarmFeed,
    sources: SourceAlarms,
    worker: Option<OfWorker>,
}

impl FleetAlarms {
    /// Joins the fleet of `config` as `name`. The worker need not run.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn with_config(config: &Config, name: &str) -> Result<Self, ConnectError> {
        let feed = AlarmFeed::with_config(config, name)?;
        Ok(Self {
            subscriber: Subscriber::polling(config, name, feed.look_every())?,
            feed,
            sources: SourceAlarms::new(config),
            worker: None,
        })
    }

    /// Waits a tenth of a second at most, and calls `each` for every change. Call it again at once,
    /// so that nothing is overwritten. It listens to no events, which would cost the worker time in
    /// every tick.
    ///
    /// # Errors
    /// [`ReadError`]. The next call may succeed, unless the fleet's files were removed.
    pub fn wait(&mut self, mut each: impl FnMut(FleetAlarm)) -> Result<(), ReadError> {
        // The event does not matter: the state shows it.
        let _ = self.subscriber.wait_next(self.feed.look_every())?;
        let now = match self.subscriber.worker_for_people() {
            WorkerState::Alive => Some(None),
            WorkerState::Gone(_) => Some(Some(AlarmCard::WORKER_GONE)),
            WorkerState::Stale { .. } => Some(Some(AlarmCard::WORKER_STALE)),
            WorkerState::Waiting => None,
        };
        if let Some(now) = now {
            self.set_worker(now, &mut each);
        }
        self.sources.changes(|change| each(change.into()));
        self.feed.changes(|change| each(change.into()))
    }

    fn set_worker(&mut self, now: Option<AlarmCard>, each: &mut impl FnMut(FleetAlarm)) {
        if self.worker.map(|(card, _)| card) == now {
            return;
        }
        let at_ns = clock::monotonic_ns();
        let mut pass_on = |(card, raised_ns): OfWorker, change| {
            each(FleetAlarm { raised_ns, ..FleetAlarm::new(None, &card, change, at_ns) });
        };
        if let Some(ended) = self.worker.take() {
            pass_on(ended, Change::Cleared);
        }
        self.worker = now.map(|card| (card, at_ns));
        if let Some(begun) = self.worker {
            pass_on(begun, Change::Raised);
        }
    }

    /// The robots' alarms that are raised, and the ticks that were missed.
    pub const fn history(&self) -> &AlarmHistory {
        self.feed.history()
    }
}

impl fmt::Debug for FleetAlarms {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("FleetAlarms")
            .field("subscriber", &self.subscriber)
            .field("feed", &self.feed)
            .field("worker", &self.worker)
            .finish()
    }
}
