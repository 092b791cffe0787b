//! The thread of the worker's host that reads as a planner does, and gives what it reads to other hosts.

use std::fmt::Display;
use std::os::unix::fs::MetadataExt as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bytemuck::{bytes_of, cast_slice};
use joulebus_bus::{Bus, Reader, clock, process_id};
use joulebus_config::Config;
use joulebus_connect::join;
use joulebus_consumer::{
    Budgets, Diagnostics, Event, Feed, PlanStates, ReadError, Subscriber, WorkerState,
};
use joulebus_standby::SavedState;
use joulebus_wire::{Channel, FrameHeader as _, Place, SCHEMA_VERSION, StateHeader, Ticks};

use crate::giving::{GivenRecord, Giving};
use crate::network::{Kind, Network};
use crate::protocol::carried::Carried;
use crate::protocol::message::{FleetId, Voice, Worker};
use crate::protocol::stream::LocalFrame;
use crate::refusals::Refusals;
use crate::turn::Turn;

/// Longest sleep: how late a request or a stop may be noticed.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// The same after a frame, where nothing waits for a request: longer than the period of most fleets, so that the next frame
/// is what ends the sleep.
const AFTER_FRAME: Duration = Duration::from_millis(40);
/// Pause before a feed that could not be opened is tried again.
const OPEN_EVERY_NS: u64 = 1_000_000_000;
/// Pause after a frame of forecasts before what the worker writes behind it is looked for.
const BEHIND: Duration = Duration::from_millis(1);
/// What the worker writes behind its forecasts.
const BEHIND_FORECASTS: [Carried; 4] = [
    Carried::DIAGNOSTICS,
    Carried::BUDGETS,
    Carried::PLAN_STATES,
    Carried::TICKS,
];
/// How often is looked for a newer state of the worker, which writes one a second.
const STATE_EVERY_NS: u64 = 100_000_000;
/// Frames in a row without a permit after which a worker is told to be none that stands by: one whose permit has ended sends
/// for 50 ms at most.
const UNPERMITTED: u32 = 100;

/// Gives until `stop`. Calls `ready` when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, fleet): (&Config, FleetId),
    (network, turn): (&Arc<Network>, Option<&Turn>),
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<(Vec<GivenRecord>, Refusals)> {
    let mut planner = Subscriber::with_config(config, "link")?;
    let mut giving = Giving::open(network, Kind::Outputs, None, fleet)?;
    let mut feeds = Feeds::new(config);
    let mut state = turn.map(StateFeed::new);
    ready();
    let mut wait = LOOK_EVERY;
    let mut unpermitted = 0_u32;
    while !stop.load(Ordering::Relaxed) {
        let told = giving.voice;
        wait = match planner.wait_next(wait) {
            Ok(Event::Frame(frame)) => {
                giving.voice = voice(Worker::Alive, turn);
                let is_permitted = turn.is_none() || giving.voice.term > 0;
                unpermitted = if is_permitted { 0 } else { unpermitted + 1 };
                if unpermitted == UNPERMITTED {
                    tracing::error!(
                        "the worker of this host serves without a permit, and other hosts do not hear it: start it with --standby"
                    );
                }
                if is_permitted {
                    if let Some(turn) = turn {
                        turn.worker_works();
                    }
                    // What has been acknowledged meanwhile makes room for this one.
                    giving.take()?;
                    let header = frame.header();
                    giving.offer(LocalFrame {
                        service: Carried::FORECASTS,
                        source: 0,
                        tick: header.tick,
                        header: bytes_of(header),
                        elements: cast_slice(frame.robots()),
                    });
                }
                if BEHIND_FORECASTS.iter().any(|it| giving.wants(*it)) {
                    BEHIND
                } else if giving.waits() {
                    LOOK_EVERY
                } else {
                    AFTER_FRAME
                }
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
        let worker = match planner.worker() {
            WorkerState::Waiting => Worker::Unknown,
            WorkerState::Alive => Worker::Alive,
            WorkerState::Gone(_) => Worker::Gone,
            _ => Worker::Stale,
        };
        giving.voice = voice(worker, turn);
        giving.turn()?;
        if turn.is_none() || giving.voice.term > 0 {
            feeds.give(&planner, &mut giving)?;
        }
        if let Some(state) = &mut state {
            state.give(&mut giving);
        }
        let is_over =
            |voice: Voice| voice.worker == Worker::Gone || (turn.is_some() && voice.term == 0);
        if is_over(giving.voice) && !is_over(told) {
            giving.tell();
        }
    }
    Ok((giving.records(), giving.refused))
}

/// What is told of the worker: one that may not serve now has no term, and those of other hosts do not hear it.
fn voice(worker: Worker, turn: Option<&Turn>) -> Voice {
    let Some(turn) = turn else {
        return worker.into();
    };
    // Of one that was to end and has not yet, too: another waits for that.
    Voice {
        worker,
        term: turn.term(),
        heard: turn.heard(),
    }
}

/// The state of the worker, for those that stand by.
struct StateFeed<'a> {
    turn: &'a Turn,
    look_ns: u64,
    /// The file of the one that was given last: its number, and when it was written, s and ns.
    given: Option<(u64, i64, i64)>,
    is_told: bool,
}

impl<'a> StateFeed<'a> {
    const fn new(turn: &'a Turn) -> Self {
        Self {
            turn,
            look_ns: 0,
            given: None,
            is_told: false,
        }
    }

    fn give(&mut self, giving: &mut Giving) {
        let now_ns = clock::monotonic_ns();
        if now_ns < self.look_ns || giving.voice.term == 0 || !giving.wants(Carried::STATE) {
            return;
        }
        self.look_ns = now_ns + STATE_EVERY_NS;
        let path = &self.turn.places().keyframe;
        let Ok(about) = joulebus_files::look(path) else {
            return;
        };
        let file = (about.ino(), about.mtime(), about.mtime_nsec());
        if self.given == Some(file) {
            return;
        }
        let saved = match SavedState::read(path) {
            Ok(Some(saved)) if saved.term == giving.voice.term => saved,
            // Of a worker before.
            Ok(_) => return,
            Err(error) => {
                if !self.is_told {
                    tracing::warn!("those that stand by get no state: {error}");
                }
                self.is_told = true;
                return;
            }
        };
        (self.given, self.is_told) = (Some(file), false);
        let header = StateHeader {
            schema: SCHEMA_VERSION,
            pid: process_id(),
            total_bytes: saved.bytes.len() as u64,
            taken_ns: saved.taken_ns,
            sent_ns: now_ns,
            ..StateHeader::default()
        };
        giving.offer(LocalFrame {
            service: Carried::STATE,
            source: 0,
            tick: 0,
            header: bytes_of(&header),
            elements: &saved.bytes,
        });
    }
}

/// What the worker writes behind its forecasts: read while somebody asks for it.
struct Feeds<'a> {
    config: &'a Config,
    diagnostics: Wanted<Feed<Diagnostics>>,
    budgets: Wanted<Feed<Budgets>>,
    plan_states: Wanted<Feed<PlanStates>>,
    // The port before the membership.
    ticks: Wanted<(Reader<Ticks>, Bus)>,
    /// The last frame of each feed.
    given: [Place; 3],
}

impl<'a> Feeds<'a> {
    const fn new(config: &'a Config) -> Self {
        Self {
            config,
            diagnostics: Wanted::new("diagnostics"),
            budgets: Wanted::new("budgets"),
            plan_states: Wanted::new("plan states"),
            ticks: Wanted::new("the journal"),
            given: [Place { run: 0, number: 0 }; 3],
        }
    }

    fn give(&mut self, planner: &Subscriber, giving: &mut Giving) -> anyhow::Result<()> {
        let [of_diagnostics, of_budgets, of_plan_states] = &mut self.given;
        let feed = (Carried::DIAGNOSTICS, &mut self.diagnostics);
        pass(feed, of_diagnostics, giving, planner)?;
        let feed = (Carried::BUDGETS, &mut self.budgets);
        pass(feed, of_budgets, giving, planner)?;
        let feed = (Carried::PLAN_STATES, &mut self.plan_states);
        pass(feed, of_plan_states, giving, planner)?;
        self.ticks(giving);
        Ok(())
    }

    fn ticks(&mut self, giving: &mut Giving) {
        let config = self.config;
        self.ticks.keep(giving.wants(Carried::TICKS), || {
            let bus = join(config, "link-journal")?;
            let reader = bus.reader::<Ticks>(&config.limits())?;
            Ok::<_, anyhow::Error>((reader, bus))
        });
        let Some((reader, _)) = &mut self.ticks.feed else {
            return;
        };
        let taken = reader.take_all(|header, frames| {
            giving.offer(LocalFrame {
                service: Carried::TICKS,
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
fn pass<C: Channel>(
    (service, wanted): (Carried, &mut Wanted<Feed<C>>),
    given: &mut Place,
    giving: &mut Giving,
    planner: &Subscriber,
) -> Result<(), ReadError> {
    wanted.keep(giving.wants(service), || planner.feed());
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
    let place = frame.header().place();
    if place == *given {
        return Ok(());
    }
    *given = place;
    giving.offer(LocalFrame {
        service,
        source: 0,
        tick: place.number,
        header: bytes_of(frame.header()),
        elements: cast_slice(frame.robots()),
    });
    Ok(())
}
