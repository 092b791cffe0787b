//! The thread of the worker's host that reads as a planner does, and gives what it reads to other hosts.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bytemuck::{bytes_of, cast_slice};
use joulebus_bus::{Bus, TickReader};
use joulebus_config::Config;
use joulebus_consumer::{
    BudgetFeed, DiagnosticFeed, Event, Feed, PlanStateFeed, Planner, WorkerState,
};
use joulebus_wire::Payload;

use crate::giving::{GivenRecord, Giving};
use crate::network::{Kind, Network};
use crate::protocol::carried::Carried;
use crate::protocol::message::Worker;
use crate::protocol::stream::LocalFrame;
use crate::refusals::Refusals;

/// Longest sleep: how late a request or a stop may be noticed.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Pause after a frame of forecasts before what the worker writes behind it is looked for.
const BEHIND: Duration = Duration::from_millis(1);

/// Gives until `stop`. Calls `ready` when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    config: &Config,
    network: &Arc<Network>,
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<(Vec<GivenRecord>, Refusals)> {
    let mut planner = Planner::with_config(config, "link")?;
    let mut giving = Giving::open(network, Kind::Outputs, None, config.fleet())?;
    let mut feeds = Feeds::new(config);
    ready();
    let mut wait = LOOK_EVERY;
    while !stop.load(Ordering::Relaxed) {
        let told = giving.worker;
        wait = match planner.wait_next(wait)? {
            Event::Frame(frame) => {
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
            _ => LOOK_EVERY,
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
    diagnostics: Option<DiagnosticFeed>,
    budgets: Option<BudgetFeed>,
    plan_states: Option<PlanStateFeed>,
    // The port before the membership.
    ticks: Option<(TickReader, Bus)>,
    /// Epoch and tick of the last frame of each feed.
    given: [(u64, u64); 3],
}

impl<'a> Feeds<'a> {
    const fn new(config: &'a Config) -> Self {
        Self {
            config,
            diagnostics: None,
            budgets: None,
            plan_states: None,
            ticks: None,
            given: [(0, 0); 3],
        }
    }

    fn give(&mut self, planner: &Planner, giving: &mut Giving) -> anyhow::Result<()> {
        let [diagnostics, budgets, plan_states] = &mut self.given;
        keep(
            &mut self.diagnostics,
            giving.wants(Carried::Diagnostics),
            || planner.diagnostics(),
        )?;
        pass(
            &mut self.diagnostics,
            Carried::Diagnostics,
            diagnostics,
            giving,
            |header| (header.worker_epoch, header.tick),
        )?;
        keep(&mut self.budgets, giving.wants(Carried::Budgets), || {
            planner.budgets()
        })?;
        pass(
            &mut self.budgets,
            Carried::Budgets,
            budgets,
            giving,
            |header| (header.worker_epoch, header.tick),
        )?;
        keep(
            &mut self.plan_states,
            giving.wants(Carried::PlanStates),
            || planner.plan_states(),
        )?;
        pass(
            &mut self.plan_states,
            Carried::PlanStates,
            plan_states,
            giving,
            |header| (header.worker_epoch, header.tick),
        )?;
        self.ticks(giving)
    }

    fn ticks(&mut self, giving: &mut Giving) -> anyhow::Result<()> {
        let config = self.config;
        keep(&mut self.ticks, giving.wants(Carried::Ticks), || {
            let bus = config.join("link-journal")?;
            let reader = bus.tick_reader(&config.limits())?;
            Ok::<_, anyhow::Error>((reader, bus))
        })?;
        let Some((reader, _)) = &mut self.ticks else {
            return Ok(());
        };
        reader.take_all(|header, frames| {
            giving.offer(LocalFrame {
                service: Carried::Ticks,
                source: 0,
                tick: header.tick,
                header: bytes_of(header),
                elements: cast_slice(frames),
            });
        })?;
        Ok(())
    }
}

/// Opens what is wanted, and closes what is not.
fn keep<F, E>(
    feed: &mut Option<F>,
    is_wanted: bool,
    open: impl FnOnce() -> Result<F, E>,
) -> Result<(), E> {
    match (feed.is_some(), is_wanted) {
        (false, true) => *feed = Some(open()?),
        (true, false) => *feed = None,
        _ => {}
    }
    Ok(())
}

/// Gives the newest frame, unless it was given.
fn pass<H: Payload, T: Payload>(
    feed: &mut Option<Feed<H, T>>,
    service: Carried,
    given: &mut (u64, u64),
    giving: &mut Giving,
    place: fn(&H) -> (u64, u64),
) -> anyhow::Result<()> {
    let Some(feed) = feed else {
        return Ok(());
    };
    let Some(frame) = feed.latest()? else {
        return Ok(());
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
