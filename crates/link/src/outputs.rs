//! The thread of the worker's host that reads as a planner does, and gives what it reads to other hosts.

use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bytemuck::{bytes_of, cast_slice};
use joulebus_bus::{Bus, TickReader, clock};
use joulebus_config::Config;
use joulebus_consumer::{
    BudgetFeed, DiagnosticFeed, Event, Feed, PlanStateFeed, Planner, ReadError, WorkerState,
};
use joulebus_wire::Payload;

use crate::giving::{GivenRecord, Giving};
use crate::network::{Kind, Network};
use crate::protocol::carried::Carried;
use crate::protocol::message::{FleetId, Worker};
use crate::protocol::stream::LocalFrame;
use crate::refusals::Refusals;

/// Longest sleep: how late a request or a stop may be noticed.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Pause before a feed that could not be opened is tried again.
const OPEN_EVERY_NS: u64 = 1_000_000_000;
/// Pause after a frame of forecasts before what the worker writes behind it is looked for.
const BEHIND: Duration = Duration::from_millis(1);

/// Gives until `stop`. Calls `ready` when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, fleet): (&Config, FleetId),
    network: &Arc<Network>,
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<(Vec<GivenRecord>, Refusals)> {
    let mut planner = Planner::with_config(config, "link")?;
    let mut giving = Giving::open(network, Kind::Outputs, None, fleet)?;
    let mut feeds = Feeds::new(config);
    ready();
    let mut wait = LOOK_EVERY;
    while !stop.load(Ordering::Relaxed) {
        let told = giving.worker;
        wait = match planner.wait_next(wait) {
            Ok(Event::Frame(frame)) => {
                giving.worker = Worker::Alive;
                let header = frame.header();
                giving.offer(LocalFrame {
                    service: Carried::Forecasts,
                    source: 0,
                    tick: header.tick,
                    header: bytes_of(header),
                    elements: cast_slice(frame.robots()),
                });
                BEHIND
            }
            Ok(_) => LOOK_EVERY,
            // Connections that failed are made again.
            Err(ReadError::Receive(error)) => {
                tracing::debug!(%error, "forecasts cannot be read");
                std::thread::sleep(LOOK_EVERY);
                LOOK_EVERY
            }
            Err(error) => return Err(error.into()),
        };
        giving.worker = match planner.worker() {
            WorkerState::Waiting => Worker::Unknown,
            WorkerState::Alive => Worker::Alive,
            WorkerState::Gone(_) => Worker::Gone,
            _ => Worker::Stale,
        };
        giving.turn()?;
        feeds.give(&planner, &mut giving)?;
        if giving.worker == Worker::Gone && told != Worker::Gone {
            giving.tell();
        }
    }
    Ok((giving.records(), giving.refused))
}

/// What the worker writes behind its forecasts: read while somebody asks for it.
struct Feeds<'a> {
    config: &'a Config,
    diagnostics: Wanted<DiagnosticFeed>,
    budgets: Wanted<BudgetFeed>,
    plan_states: Wanted<PlanStateFeed>,
    // The port before the membership.
    ticks: Wanted<(TickReader, Bus)>,
    /// Epoch and tick of the last frame of each feed.
    given: [(u64, u64); 3],
}

impl<'a> Feeds<'a> {
    const fn new(config: &'a Config) -> Self {
        Self {
            config,
            diagnostics: Wanted::new("diagnostics"),
            budgets: Wanted::new("budgets"),
            plan_states: Wanted::new("plan states"),
            ticks: Wanted::new("the journal"),
            given: [(0, 0); 3],
        }
    }

    fn give(&mut self, planner: &Planner, giving: &mut Giving) -> anyhow::Result<()> {
        let [of_diagnostics, of_budgets, of_plan_states] = &mut self.given;
        let (service, feed) = (Carried::Diagnostics, &mut self.diagnostics);
        feed.keep(giving.wants(service), || planner.diagnostics());
        pass((service, feed), of_diagnostics, giving, |header| {
            (header.worker_epoch, header.tick)
        })?;
        let (service, feed) = (Carried::Budgets, &mut self.budgets);
        feed.keep(giving.wants(service), || planner.budgets());
        pass((service, feed), of_budgets, giving, |header| {
            (header.worker_epoch, header.tick)
        })?;
        let (service, feed) = (Carried::PlanStates, &mut self.plan_states);
        feed.keep(giving.wants(service), || planner.plan_states());
        pass((service, feed), of_plan_states, giving, |header| {
            (header.worker_epoch, header.tick)
        })?;
        self.ticks(giving);
        Ok(())
    }

    fn ticks(&mut self, giving: &mut Giving) {
        let config = self.config;
        self.ticks.keep(giving.wants(Carried::Ticks), || {
            let bus = config.join("link-journal")?;
            let reader = bus.tick_reader(&config.limits())?;
            Ok::<_, anyhow::Error>((reader, bus))
        });
        let Some((reader, _)) = &mut self.ticks.feed else {
            return;
        };
        let taken = reader.take_all(|header, frames| {
            giving.offer(LocalFrame {
                service: Carried::Ticks,
                source: 0,
                tick: header.tick,
                header: bytes_of(header),
                elements: cast_slice(frames),
            });
        });
        if let Err(error) = taken {
            self.ticks.fails(&error);
        }
    }
}

/// A feed that is open while somebody wants it. What fails is said once, and tried again: readers come and go.
struct Wanted<F> {
    what: &'static str,
    feed: Option<F>,
    again_ns: u64,
    is_told: bool,
}

impl<F> Wanted<F> {
    const fn new(what: &'static str) -> Self {
        Self {
            what,
            feed: None,
            again_ns: 0,
            is_told: false,
        }
    }

    fn keep<E: Display>(&mut self, is_wanted: bool, open: impl FnOnce() -> Result<F, E>) {
        if !is_wanted {
            self.feed = None;
            return;
        }
        if self.feed.is_some() || clock::monotonic_ns() < self.again_ns {
            return;
        }
        match open() {
            Ok(feed) => self.feed = Some(feed),
            Err(error) => self.fails(&error),
        }
    }

    fn fails(&mut self, error: &dyn Display) {
        if !self.is_told {
            tracing::warn!("{} cannot be read: {error}", self.what);
        }
        self.is_told = true;
        self.again_ns = clock::monotonic_ns() + OPEN_EVERY_NS;
    }
}

/// Gives the newest frame, unless it was given.
fn pass<H: Payload, T: Payload>(
    (service, wanted): (Carried, &mut Wanted<Feed<H, T>>),
    given: &mut (u64, u64),
    giving: &mut Giving,
    place: fn(&H) -> (u64, u64),
) -> Result<(), ReadError> {
    let Some(feed) = &mut wanted.feed else {
        return Ok(());
    };
    let frame = match feed.latest() {
        Ok(Some(frame)) => frame,
        Ok(None) => return Ok(()),
        Err(ReadError::Receive(error)) => {
            wanted.fails(&error);
            return Ok(());
        }
        Err(error) => return Err(error),
    };
    let now = place(frame.header());
    if now == *given {
        return Ok(());
    }
    *given = now;
    giving.offer(LocalFrame {
        service,
        source: 0,
        tick: now.1,
        header: bytes_of(frame.header()),
        elements: cast_slice(frame.robots()),
    });
    Ok(())
}
