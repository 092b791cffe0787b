//! The thread of a planners' host: puts what workers elsewhere write into this host's shared memory, in a worker's place.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use joulebus_bus::{SendError, WorkerLock, clock};
use joulebus_config::Config;
use joulebus_connect::join;
use joulebus_wire::WakeEvent;

use crate::config::{Follow, Settings};
use crate::gathered::Gathered;
use crate::network::{Bytes, Event, Inbox, Kind, Network, longest_bytes};
use crate::outlets::{Outlets, PassError};
use crate::protocol::carried::Carried;
use crate::protocol::lease::MOST_TTL_S;
use crate::protocol::message::Worker;
use crate::protocol::receiver::Accepted;
use crate::taking::{TakenRecord, Taking};

/// Longest sleep: how late a stop, a silence or a new reader of plan states may be noticed.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// The same after a message: longer than the period of most fleets, so that the next message is what ends the sleep.
const AFTER_MESSAGE: Duration = Duration::from_millis(40);
/// The same while frames of several shards are gathered: a shard that is late holds the others up by as much.
const GATHER_EVERY: Duration = Duration::from_millis(5);
/// A term in which nobody has sent for so long fences nobody: longer than the longest lease, so that no older one lasts.
const FORGOTTEN_AFTER_NS: u64 = 2 * MOST_TTL_S as u64 * 1_000_000_000;

/// Follows until `stop`. Calls `ready` when the outputs can be read.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, settings, follow): (&Config, &Settings, &Follow),
    (network, lock): (&Arc<Network>, &WorkerLock),
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<Vec<TakenRecord>> {
    let mut bus = join(config, "link")?;
    bus.needs_lock(lock);
    let mut inbox = Inbox::new(longest_bytes(config.limits().capacity));
    let shards = open(config, settings, follow, network, &mut inbox)?;
    let every = follow.selection.every;
    let gathered = match &settings.shards {
        Some(map) if shards.len() > 1 => Some(Gathered::new(map, config, every)),
        _ => None,
    };
    let mut following = Following {
        outlets: Outlets::open(&bus, config, every)?,
        shards,
        gathered,
        asks: follow.selection.services,
        has_message: false,
        told: Worker::Unknown,
    };
    ready();
    while !stop.load(Ordering::Relaxed) {
        bus.check()?;
        following.turn(&inbox)?;
    }
    following.outlets.planners.wake(WakeEvent::Ended)?;
    let takings = following.shards.iter().flat_map(|shard| &shard.takings);
    let mut records: Vec<TakenRecord> = takings.map(Taking::record).collect();
    if let Some(first) = records.first_mut() {
        first.received.lost += inbox.overflowed();
    }
    Ok(records)
}

/// Asks every link that may speak for a shard.
fn open(
    config: &Config,
    settings: &Settings,
    follow: &Follow,
    network: &Arc<Network>,
    inbox: &mut Inbox,
) -> anyhow::Result<Vec<ShardFeed>> {
    let limits = config.limits();
    let most = limits.capacity.max(limits.listed_frames());
    let mut shards = Vec::new();
    for workers in &follow.workers {
        let mut takings = Vec::new();
        for worker in workers {
            takings.push(Taking::open(
                network,
                (Kind::Outputs, worker),
                (settings.fleet(config), most),
                follow.selection.clone(),
                inbox,
            )?);
        }
        shards.push(ShardFeed {
            takings,
            speaker: 0,
            highest: Highest::default(),
            told: Worker::Unknown,
        });
    }
    Ok(shards)
}

/// What comes from those that may speak for a shard, or for a fleet that is not split.
struct ShardFeed {
    takings: Vec<Taking>,
    /// The one whose frames are passed on.
    speaker: usize,
    highest: Highest,
    /// State of the worker that was told last.
    told: Worker,
}

/// The greatest term in which a shard's workers have sent: one that has been followed by another is not heard any more.
#[derive(Debug, Clone, Copy, Default)]
struct Highest {
    term: u64,
    /// When somebody sent in it last, monotonic ns.
    at_ns: u64,
}

impl Highest {
    /// The term below which nobody is heard at `now_ns`. Where nobody has sent in it for longer than any lease lasts, the
    /// store and all candidates may have forgotten it.
    const fn at(self, now_ns: u64) -> u64 {
        if now_ns.saturating_sub(self.at_ns) > FORGOTTEN_AFTER_NS {
            0
        } else {
            self.term
        }
    }

    /// Somebody sends in `term`: whether that is one in which nobody has sent.
    const fn sends(&mut self, term: u64, now_ns: u64) -> bool {
        let highest = self.at(now_ns);
        if term >= highest {
            (self.term, self.at_ns) = (term, now_ns);
        }
        term > highest
    }

    /// The worker of `term` serves, as its link says: of one of which every so many ticks is asked for, frames may be further
    /// apart than a term is remembered.
    const fn serves(&mut self, term: u64, now_ns: u64) {
        if term == self.term && term == self.at(now_ns) {
            self.at_ns = now_ns;
        }
    }
}

impl ShardFeed {
    /// The state of its worker; unknown while nothing comes.
    fn worker(&mut self) -> Worker {
        let receiver = self.takings[self.speaker].receiver();
        match receiver.worker() {
            _ if !receiver.is_heard() => Worker::Unknown,
            Worker::Alive if receiver.term() < self.highest.at(clock::monotonic_ns()) => {
                Worker::Unknown
            }
            worker => worker,
        }
    }

    /// Another speaks where the one that spoke has ended or is not heard.
    fn choose(&mut self) {
        if self.worker() == Worker::Alive {
            return;
        }
        let highest = self.highest.at(clock::monotonic_ns());
        let is_alive = |taking: &mut Taking| {
            let receiver = taking.receiver();
            let is_fenced = receiver.term() < highest;
            receiver.is_heard() && receiver.worker() == Worker::Alive && !is_fenced
        };
        if let Some(alive) = self.takings.iter_mut().position(is_alive) {
            self.speaker = alive;
        }
    }

    /// Says once what its worker does now.
    fn tell(&mut self) {
        let worker = self.worker();
        if worker == self.told {
            return;
        }
        let from = self.takings[self.speaker].from();
        match worker {
            Worker::Alive => tracing::info!("the worker of {from} sends"),
            Worker::Gone => tracing::warn!("the worker of {from} has ended"),
            Worker::Stale => tracing::warn!("the worker of {from} is silent"),
            Worker::Unknown => tracing::warn!("nothing comes from {from}"),
        }
        self.told = worker;
    }
}

struct Following {
    outlets: Outlets,
    shards: Vec<ShardFeed>,
    /// Where frames of several workers become one.
    gathered: Option<Gathered>,
    /// Services that the file names.
    asks: u32,
    /// The last turn took a message.
    has_message: bool,
    /// State of the fleet's workers that planners here have been told last.
    told: Worker,
}

impl Following {
    fn turn(&mut self, inbox: &Inbox) -> anyhow::Result<()> {
        // Sent only while somebody reads them, as the worker itself does.
        let plans = Carried::PLAN_STATES.bit();
        let is_read = self.outlets.plan_states.readers() > 0;
        let services = if is_read {
            self.asks
        } else {
            self.asks & !plans
        };
        for taking in self.takings() {
            taking.receiver().select(services);
            taking.ask();
        }
        let wait = match self.gathered {
            Some(_) => GATHER_EVERY,
            None if self.has_message => AFTER_MESSAGE,
            None => LOOK_EVERY,
        };
        self.has_message = false;
        match inbox.next(wait) {
            Ok(Event::Message {
                from,
                bytes,
                arrived_ns,
            }) => {
                self.has_message = true;
                self.message(&from, &bytes, arrived_ns)?;
            }
            Ok(Event::Lost { name }) => {
                for taking in self.takings().filter(|taking| *taking.from() == *name) {
                    taking.receiver().lost();
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
        let now_ns = clock::monotonic_ns();
        for shard in &mut self.shards {
            for taking in &mut shard.takings {
                taking.receiver().falls_silent(now_ns);
            }
            shard.choose();
            shard.tell();
        }
        if let Some(gathered) = &mut self.gathered {
            let speaks = self
                .shards
                .iter_mut()
                .map(|it| it.worker() == Worker::Alive);
            let speaks: Vec<bool> = speaks.collect();
            let written = gathered.write(&mut self.outlets, &speaks);
            is_final(written)?;
        }
        self.tell()
    }

    fn takings(&mut self) -> impl Iterator<Item = &mut Taking> {
        self.shards.iter_mut().flat_map(|shard| &mut shard.takings)
    }

    /// Takes a message of the link `from`.
    fn message(&mut self, from: &str, bytes: &Bytes, arrived_ns: u64) -> Result<(), SendError> {
        let Self {
            outlets,
            shards,
            gathered,
            ..
        } = self;
        let mut ended = Ok(());
        for (at, shard) in shards.iter_mut().enumerate() {
            let ShardFeed {
                takings,
                speaker,
                highest,
                ..
            } = shard;
            let Some(place) = takings.iter().position(|taking| taking.from() == from) else {
                continue;
            };
            let mut is_fenced = false;
            takings[place].message(bytes, arrived_ns, |accepted: Accepted<'_>| {
                if highest.sends(accepted.term, arrived_ns) {
                    *speaker = place;
                }
                is_fenced = accepted.term < highest.at(arrived_ns);
                let speaks = place == *speaker && !is_fenced;
                let passed = match gathered {
                    _ if !speaks => Ok(()),
                    Some(gathered) => gathered.put(at, &accepted),
                    None => outlets.pass_on(&accepted),
                };
                passed.map_err(|error| {
                    let shown = error.to_string();
                    if let PassError::Send(error) = error
                        && error.is_final()
                    {
                        ended = Err(error);
                    }
                    ("not passed on", shown)
                })
            });
            takings[place].fenced += u64::from(is_fenced);
            let receiver = takings[place].receiver();
            if receiver.is_heard() && receiver.worker() == Worker::Alive {
                highest.serves(receiver.term(), arrived_ns);
            }
        }
        ended
    }

    /// Planners are told once that nothing is to be expected of any worker, and why.
    fn tell(&mut self) -> anyhow::Result<()> {
        let mut states = self.shards.iter_mut().map(ShardFeed::worker);
        let worker = states
            .by_ref()
            .fold(Worker::Unknown, |all, state| match (all, state) {
                (Worker::Alive, _) | (_, Worker::Alive) => Worker::Alive,
                (Worker::Unknown, state) => state,
                (all, _) => all,
            });
        if worker == self.told {
            return Ok(());
        }
        let event = match worker {
            Worker::Alive | Worker::Stale => None,
            Worker::Gone => Some(WakeEvent::Ended),
            Worker::Unknown => Some(WakeEvent::Unreachable),
        };
        if let Some(event) = event {
            self.outlets.planners.wake(event)?;
        }
        self.told = worker;
        Ok(())
    }
}

/// Errors that end the link; others were of one frame.
fn is_final(sent: Result<(), SendError>) -> Result<(), SendError> {
    match sent {
        Err(error) if error.is_final() => Err(error),
        Err(error) => {
            tracing::debug!(%error, "a frame was not passed on");
            Ok(())
        }
        Ok(()) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_older_term_is_fenced_until_nobody_has_sent_in_the_later_one_for_longer_than_a_lease_lasts()
     {
        let mut highest = Highest::default();
        assert!(!highest.sends(0, 1), "of the only worker");
        assert!(highest.sends(3, 5));
        for (term, now_ns) in [(3, 6), (2, 7), (0, 8)] {
            assert!(!highest.sends(term, now_ns));
            assert_eq!(highest.at(now_ns), 3);
        }
        assert!(highest.sends(4, 9));
        // What an older one sends does not keep the fence up.
        let later_ns = 9 + FORGOTTEN_AFTER_NS;
        assert!(!highest.sends(3, later_ns));
        assert_eq!(highest.at(later_ns), 4);
        assert_eq!(highest.at(later_ns + 1), 0);
        assert!(highest.sends(1, later_ns + 1));
        assert_eq!(highest.at(later_ns + 2), 1);
    }

    #[test]
    fn a_term_is_remembered_while_its_worker_serves_however_rarely_its_frames_come() {
        let mut highest = Highest::default();
        assert!(highest.sends(3, 0));
        // Statuses come ten times a second, and frames not for an hour.
        for now_ns in (0..3_600_000_000_000).step_by(100_000_000) {
            highest.serves(3, now_ns);
            // One that nobody follows does not keep the fence up, nor take it down.
            highest.serves(2, now_ns);
            assert_eq!(highest.at(now_ns), 3);
        }
        let last_ns = 3_600_000_000_000 - 100_000_000;
        assert!(!highest.sends(2, last_ns + FORGOTTEN_AFTER_NS));
        assert_eq!(highest.at(last_ns + FORGOTTEN_AFTER_NS + 1), 0);
        // What was forgotten does not come back by a status.
        for term in [3, 0] {
            highest.serves(term, last_ns + FORGOTTEN_AFTER_NS + 1);
        }
        assert_eq!(highest.at(last_ns + FORGOTTEN_AFTER_NS + 1), 0);
    }
}
