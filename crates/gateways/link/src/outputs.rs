//! The thread of the worker's host that reads as a planner, and sends the frames to other hosts.

use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use bytemuck::{bytes_of, cast_slice};
use joulebus_bus::{Bus, Reader, Rounds, clock, process_id};
use joulebus_config::Config;
use joulebus_connect::join;
use joulebus_connect::standby::SavedState;
use joulebus_consumer::{Event, Feed, ReadError, Subscriber, WorkerState};
use joulebus_files::disk;
use joulebus_wire::{Channel, FrameHeader as _, FrameOrder, SCHEMA_VERSION, StateHeader, Ticks};

use crate::egress::Egress;
use crate::leadership::Leadership;
use crate::protocol::carried::{Carried, Kind, OfChannel};
use crate::protocol::message::{LeaderStatus, Worker};
use crate::protocol::stream::LocalFrame;
use crate::report::Done;
use crate::shared::Shared;

/// Maximum sleep: the delay until a request or a stop is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Maximum sleep after a frame if no frame waits for a request. It exceeds the period of most
/// fleets, so that the next frame ends the sleep.
const AFTER_FRAME: Duration = Duration::from_millis(40);
/// Pause before the next attempt to open a feed.
const RETRY_OPEN_NS: u64 = 1_000_000_000;
/// Pause between a frame of forecasts and the frames that the worker writes after it.
const BEHIND: Duration = Duration::from_millis(1);
/// Interval of checks for a newer state of the worker, which writes one a second.
const STATE_POLL_INTERVAL_NS: u64 = 100_000_000;
/// Number of consecutive frames without a permit after which the worker is reported as started
/// without `--standby`. A worker whose permit has ended sends for 50 ms at most.
const UNPERMITTED: u32 = 100;

/// Sends the frames of this host's worker.
pub(crate) struct Outputs {
    shared: Arc<Shared>,
    planner: Subscriber,
    egress: Egress,
    feeds: Feeds,
    state: StateFeed,
    wait: Duration,
    /// Consecutive frames without a permit.
    unpermitted: u32,
}

impl Outputs {
    /// # Errors
    /// The fleet cannot be joined, or the network is refused.
    pub(crate) fn open(shared: Arc<Shared>) -> anyhow::Result<Self> {
        Ok(Self {
            planner: Subscriber::with_config(&shared.config, "link")?,
            egress: Egress::open(Arc::clone(&shared), Kind::Outputs, None)?,
            feeds: Feeds::new(),
            state: StateFeed::default(),
            wait: POLL_INTERVAL,
            unpermitted: 0,
            shared,
        })
    }
}

impl Rounds<Done, anyhow::Error> for Outputs {
    fn round(&mut self) -> anyhow::Result<Duration> {
        let Self { shared, planner, egress, feeds, wait, unpermitted, .. } = self;
        let leadership = shared.leadership.as_deref();
        let before = egress.leader;
        let mut pause = Duration::ZERO;
        *wait = match planner.wait_next(*wait) {
            Ok(Event::Frame(frame)) => {
                egress.leader = leader_status(Worker::Alive, leadership);
                let is_permitted = leadership.is_none() || egress.leader.term > 0;
                *unpermitted = if is_permitted { 0 } else { *unpermitted + 1 };
                if *unpermitted == UNPERMITTED {
                    tracing::error!(
                        "the worker of this host serves without a permit, and other hosts ignore it: start it with --standby"
                    );
                }
                if is_permitted {
                    if let Some(leadership) = leadership {
                        leadership.worker_sends();
                    }
                    // Acknowledgements that have arrived make room for this frame.
                    egress.take()?;
                    let header = frame.header();
                    egress.offer(LocalFrame {
                        service: Carried::FORECASTS,
                        source: 0,
                        tick: header.tick,
                        header: bytes_of(header),
                        elements: cast_slice(frame.robots()),
                    });
                }
                if feeds.are_wanted(egress) {
                    BEHIND
                } else if egress.waits() {
                    POLL_INTERVAL
                } else {
                    AFTER_FRAME
                }
            }
            Ok(_) => POLL_INTERVAL,
            // Failed connections are made again.
            Err(ReadError::Receive(error)) => {
                tracing::debug!(%error, "forecasts cannot be read");
                pause = POLL_INTERVAL;
                POLL_INTERVAL
            }
            Err(error) => return Err(error.into()),
        };
        let worker = match planner.worker() {
            WorkerState::Waiting => Worker::Unknown,
            WorkerState::Alive => Worker::Alive,
            WorkerState::Gone(_) => Worker::Gone,
            _ => Worker::Stale,
        };
        egress.leader = leader_status(worker, leadership);
        egress.poll()?;
        if leadership.is_none() || egress.leader.term > 0 {
            feeds.give(&shared.config, planner, egress)?;
        }
        if let Some(leadership) = leadership {
            self.state.give(leadership, egress);
        }
        let is_over = |leader: LeaderStatus| {
            leader.worker == Worker::Gone || (leadership.is_some() && leader.term == 0)
        };
        if is_over(egress.leader) && !is_over(before) {
            egress.send_status();
        }
        Ok(pause)
    }

    fn finish(self) -> anyhow::Result<Done> {
        Ok(self.egress.finish())
    }
}

/// The status of this host's worker for its receivers. A worker that may not lead now has no term,
/// and other hosts ignore it.
fn leader_status(worker: Worker, leadership: Option<&Leadership>) -> LeaderStatus {
    let Some(leadership) = leadership else {
        return worker.into();
    };
    // Also while the old leader is shutting down: its successor waits for it.
    LeaderStatus { worker, term: leadership.term(), highest_term: leadership.highest_term() }
}

/// The worker's state, for the standbys.
#[derive(Default)]
struct StateFeed {
    look_ns: u64,
    /// The file that was sent last.
    sent: Option<disk::Version>,
    is_logged: bool,
}

impl StateFeed {
    fn give(&mut self, leadership: &Leadership, egress: &mut Egress) {
        let now_ns = clock::monotonic_ns();
        if now_ns < self.look_ns || egress.leader.term == 0 || !egress.wants(Carried::STATE) {
            return;
        }
        self.look_ns = now_ns + STATE_POLL_INTERVAL_NS;
        let path = &leadership.places().keyframe;
        let Ok(file) = disk::version(path) else {
            return;
        };
        if self.sent == Some(file) {
            return;
        }
        let saved = match SavedState::read(path) {
            Ok(Some(saved)) if saved.term == egress.leader.term => saved,
            // The state of an earlier worker.
            Ok(_) => return,
            Err(error) => {
                if !self.is_logged {
                    tracing::warn!("standby workers get no state: {error}");
                }
                self.is_logged = true;
                return;
            }
        };
        (self.sent, self.is_logged) = (Some(file), false);
        let header = StateHeader {
            schema: SCHEMA_VERSION,
            pid: process_id(),
            total_bytes: saved.bytes.len() as u64,
            taken_ns: saved.taken_ns,
            sent_ns: now_ns,
            ..StateHeader::default()
        };
        egress.offer(LocalFrame {
            service: Carried::STATE,
            source: 0,
            tick: 0,
            header: bytes_of(&header),
            elements: &saved.bytes,
        });
    }
}

/// [`pass`] of a channel.
type Pass = Box<dyn FnMut(&Subscriber, &mut Egress) -> Result<(), ReadError>>;

/// The services that the worker writes after its forecasts. They are read only while a receiver
/// requests them.
struct Feeds {
    behind: Vec<(Carried, Pass)>,
    // Declared in this order: the port is dropped before the membership.
    ticks: Wanted<(Reader<Ticks>, Bus)>,
}

struct NewFeed;

impl OfChannel for NewFeed {
    type Made = (Carried, Pass);

    fn make<C: Channel>(&self, service: Carried) -> Self::Made {
        let (mut wanted, mut sent) = (Wanted::<Feed<C>>::new(service), FrameOrder::default());
        (service, Box::new(move |planner, egress| pass(&mut wanted, &mut sent, planner, egress)))
    }
}

impl Feeds {
    fn new() -> Self {
        Self { behind: Carried::behind_forecasts(&NewFeed), ticks: Wanted::new(Carried::TICKS) }
    }

    /// True if a receiver requests any of them.
    fn are_wanted(&self, egress: &Egress) -> bool {
        let mut behind = self.behind.iter();
        behind.any(|(service, _)| egress.wants(*service)) || egress.wants(Carried::TICKS)
    }

    fn give(
        &mut self,
        config: &Config,
        planner: &Subscriber,
        egress: &mut Egress,
    ) -> Result<(), ReadError> {
        self.behind.iter_mut().try_for_each(|(_, pass)| pass(planner, egress))?;
        self.ticks(config, egress);
        Ok(())
    }

    fn ticks(&mut self, config: &Config, egress: &mut Egress) {
        self.ticks.keep(egress, || {
            let bus = join(config, "link-journal")?;
            let reader = bus.reader::<Ticks>(&config.limits())?;
            Ok::<_, anyhow::Error>((reader, bus))
        });
        let Some((reader, _)) = &mut self.ticks.feed else {
            return;
        };
        let taken = reader.take_all(|header, frames| {
            egress.offer(LocalFrame {
                service: Carried::TICKS,
                source: 0,
                tick: header.tick,
                header: bytes_of(header),
                elements: cast_slice(frames),
            });
        });
        if let Err(error) = taken {
            self.ticks.log_failure(&error);
        }
    }
}

/// A feed that is open while a receiver requests it. A failure is logged once and retried, because
/// readers come and go.
struct Wanted<F> {
    service: Carried,
    feed: Option<F>,
    again_ns: u64,
    is_logged: bool,
}

impl<F> Wanted<F> {
    const fn new(service: Carried) -> Self {
        Self { service, feed: None, again_ns: 0, is_logged: false }
    }

    fn keep<E: Display>(&mut self, egress: &Egress, open: impl FnOnce() -> Result<F, E>) {
        if !egress.wants(self.service) {
            self.feed = None;
            return;
        }
        if self.feed.is_some() || clock::monotonic_ns() < self.again_ns {
            return;
        }
        match open() {
            Ok(feed) => self.feed = Some(feed),
            Err(error) => self.log_failure(&error),
        }
    }

    fn log_failure(&mut self, error: &dyn Display) {
        if !self.is_logged {
            tracing::warn!("{} cannot be read: {error}", self.service.name);
        }
        self.is_logged = true;
        self.again_ns = clock::monotonic_ns() + RETRY_OPEN_NS;
    }
}

/// Sends the newest frame, unless it was sent before.
fn pass<C: Channel>(
    wanted: &mut Wanted<Feed<C>>,
    sent: &mut FrameOrder,
    planner: &Subscriber,
    egress: &mut Egress,
) -> Result<(), ReadError> {
    wanted.keep(egress, || planner.feed());
    let Some(feed) = &mut wanted.feed else {
        return Ok(());
    };
    let frame = match feed.latest() {
        Ok(Some(frame)) => frame,
        Ok(None) => return Ok(()),
        Err(ReadError::Receive(error)) => {
            wanted.log_failure(&error);
            return Ok(());
        }
        Err(error) => return Err(error),
    };
    let order = frame.header().order();
    if order == *sent {
        return Ok(());
    }
    *sent = order;
    egress.offer(LocalFrame {
        service: wanted.service,
        source: 0,
        tick: order.number,
        header: bytes_of(frame.header()),
        elements: cast_slice(frame.robots()),
    });
    Ok(())
}
