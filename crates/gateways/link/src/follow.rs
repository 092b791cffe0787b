//! The thread of a planners' host: writes the frames of a worker elsewhere into this host's shared
//! memory, in its place.

use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use joulebus_bus::{Bus, Rounds, SendError, clock};
use joulebus_wire::WakeEvent;

use crate::config::Follow;
use crate::ingress::{self, Ingress};
use crate::network::{Bytes, Event, Inbox, NetworkError};
use crate::output_port::PassError;
use crate::protocol::carried::{Kind, max_message_bytes};
use crate::protocol::lease::MAX_TTL_S;
use crate::protocol::message::Worker;
use crate::protocol::receiver::Accepted;
use crate::report::Done;
use crate::shared::Shared;
use crate::worker_ports::WorkerPorts;

/// Maximum sleep: the delay until a stop, a silence or a new reader of plan states is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Maximum sleep after a message. It exceeds the period of most fleets, so that the next message
/// ends the sleep.
const AFTER_MESSAGE: Duration = Duration::from_millis(40);
/// Time without frames after which a term no longer fences off earlier ones. It exceeds the longest
/// lease, so no earlier lease is left.
const TERM_TIMEOUT_NS: u64 = 2 * MAX_TTL_S as u64 * 1_000_000_000;

/// The streams of all candidates, or of the only worker.
struct WorkerFeed {
    ingresses: Vec<Ingress>,
    /// Index of the leader, whose frames are passed on.
    leader: usize,
    highest: HighestTerm,
    /// The worker's state that was logged last.
    reported: Worker,
}

/// The highest term in which candidates have sent. It fences off the leaders of earlier terms.
#[derive(Debug, Clone, Copy, Default)]
struct HighestTerm {
    term: u64,
    /// When a candidate last sent in it, monotonic ns.
    at_ns: u64,
}

impl HighestTerm {
    /// The term below which frames are dropped at `now_ns`. If no candidate has sent in it for
    /// longer than any lease lasts, the store and all candidates may have lost it.
    const fn at(self, now_ns: u64) -> u64 {
        if now_ns.saturating_sub(self.at_ns) > TERM_TIMEOUT_NS { 0 } else { self.term }
    }

    /// Notes a frame of `term`. Returns whether the term is new.
    const fn observe_frame(&mut self, term: u64, now_ns: u64) -> bool {
        let highest = self.at(now_ns);
        if term >= highest {
            (self.term, self.at_ns) = (term, now_ns);
        }
        term > highest
    }

    /// Notes that the leader of `term` is alive, according to its link. With decimation, frames may
    /// be farther apart than a term is remembered.
    const fn observe_leader(&mut self, term: u64, now_ns: u64) {
        if term == self.term && term == self.at(now_ns) {
            self.at_ns = now_ns;
        }
    }
}

impl WorkerFeed {
    /// Opens a stream from every candidate.
    fn open(shared: &Shared, follow: &Follow, inbox: &mut Inbox) -> Result<Self, NetworkError> {
        let limits = shared.config.limits();
        let most = limits.capacity.max(limits.listed_frames());
        let open = |worker: &String| {
            let from = (Kind::Outputs, worker.as_str());
            Ingress::open(shared, from, most, follow.selection.clone(), inbox)
        };
        Ok(Self {
            ingresses: follow.workers.iter().map(open).collect::<Result<_, _>>()?,
            leader: 0,
            highest: HighestTerm::default(),
            reported: Worker::Unknown,
        })
    }

    /// The state of the worker. Unknown while nothing arrives.
    fn worker(&mut self) -> Worker {
        let receiver = self.ingresses[self.leader].receiver();
        match receiver.worker() {
            _ if !receiver.is_sending() => Worker::Unknown,
            Worker::Alive if receiver.term() < self.highest.at(clock::monotonic_ns()) => {
                Worker::Unknown
            }
            worker => worker,
        }
    }

    /// Chooses another leader if the present one has ended or is out of reach.
    fn choose(&mut self) {
        // Keep a leader that is alive, so that candidates do not alternate.
        if self.worker() == Worker::Alive {
            return;
        }
        let highest = self.highest.at(clock::monotonic_ns());
        let is_alive = |ingress: &mut Ingress| {
            let receiver = ingress.receiver();
            let is_fenced = receiver.term() < highest;
            receiver.is_sending() && receiver.worker() == Worker::Alive && !is_fenced
        };
        if let Some(alive) = self.ingresses.iter_mut().position(is_alive) {
            self.leader = alive;
        }
    }

    /// Logs a change of the worker's state.
    fn report(&mut self) {
        let worker = self.worker();
        if worker == self.reported {
            return;
        }
        let from = self.ingresses[self.leader].from();
        match worker {
            Worker::Alive => tracing::info!("the worker of {from} sends"),
            Worker::Gone => tracing::warn!("the worker of {from} has ended"),
            Worker::Stale => tracing::warn!("the worker of {from} is silent"),
            Worker::Unknown => tracing::warn!("nothing comes from {from}"),
        }
        self.reported = worker;
    }
}

pub(crate) struct Following {
    worker_ports: WorkerPorts,
    bus: Bus,
    inbox: Inbox,
    feed: WorkerFeed,
    /// Services that the link's file names.
    requested: u32,
    /// The last round took a message.
    has_message: bool,
    /// The worker's state that planners here know.
    reported: Worker,
}

impl Rounds<Done, anyhow::Error> for Following {
    fn round(&mut self) -> anyhow::Result<Duration> {
        self.bus.check()?;
        // Some services are requested only while somebody here reads them, as the worker itself
        // writes them.
        let services = self.requested & !self.worker_ports.unread();
        for ingress in &mut self.feed.ingresses {
            ingress.receiver().select(services);
            ingress.request_if_due();
        }
        let has_message = std::mem::take(&mut self.has_message);
        let wait = if has_message { AFTER_MESSAGE } else { POLL_INTERVAL };
        match self.inbox.next(wait) {
            Ok(Event::Message { from, bytes, arrived_ns }) => {
                self.has_message = true;
                self.message(&from, &bytes, arrived_ns)?;
            }
            Ok(Event::Lost { name }) => {
                let ingresses = self.feed.ingresses.iter_mut();
                for ingress in ingresses.filter(|ingress| *ingress.from() == *name) {
                    ingress.receiver().lost();
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
        let now_ns = clock::monotonic_ns();
        for ingress in &mut self.feed.ingresses {
            ingress.receiver().becomes_silent(now_ns);
        }
        self.feed.choose();
        self.feed.report();
        self.report()?;
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<Done> {
        self.worker_ports.planners.wake(WakeEvent::Ended)?;
        Ok(ingress::finish(self.feed.ingresses.iter(), &self.inbox))
    }
}

impl Following {
    /// # Errors
    /// The fleet cannot be joined, or the network is refused.
    pub(crate) fn open(shared: &Shared, follow: &Follow) -> anyhow::Result<Self> {
        let config = &shared.config;
        let bus = shared.join()?;
        let mut inbox = Inbox::new(max_message_bytes(config.limits().capacity));
        let feed = WorkerFeed::open(shared, follow, &mut inbox)?;
        Ok(Self {
            worker_ports: WorkerPorts::open(&bus, config, follow.selection.every)?,
            bus,
            inbox,
            feed,
            requested: follow.selection.services,
            has_message: false,
            reported: Worker::Unknown,
        })
    }

    /// Handles a message of the link `from`.
    ///
    /// 1. Its ingress checks order and size, and calls back for each frame that it accepts.
    /// 2. A frame of a higher term than any before makes its sender the leader at once.
    /// 3. A frame of a lower term is fenced: another candidate has led since.
    /// 4. Frames of the leader go to this host's ports. An error that lasts ends the thread.
    /// 5. A status of a living worker keeps its term the highest while it sends no frame.
    fn message(&mut self, from: &str, bytes: &Bytes, arrived_ns: u64) -> Result<(), SendError> {
        let Self { worker_ports, feed, .. } = self;
        let WorkerFeed { ingresses, leader, highest, .. } = feed;
        let Some(place) = ingresses.iter().position(|ingress| ingress.from() == from) else {
            return Ok(());
        };
        let (mut ended, mut is_fenced) = (Ok(()), false);
        ingresses[place].message(bytes, arrived_ns, |accepted: Accepted<'_>| {
            // A frame of a new term makes its sender the leader at once.
            if highest.observe_frame(accepted.term, arrived_ns) {
                *leader = place;
            }
            // Another candidate has led since, so this one's frames are out of date.
            is_fenced = accepted.term < highest.at(arrived_ns);
            if place != *leader || is_fenced {
                return Ok(());
            }
            worker_ports.pass_on(&accepted).map_err(|error| {
                let shown = error.to_string();
                if let PassError::Send(error) = error
                    && error.is_final()
                {
                    ended = Err(error);
                }
                ("not passed on", shown)
            })
        });
        ingresses[place].fenced += u64::from(is_fenced);
        let receiver = ingresses[place].receiver();
        if receiver.is_sending() && receiver.worker() == Worker::Alive {
            highest.observe_leader(receiver.term(), arrived_ns);
        }
        ended
    }

    /// Wakes planners once when the worker is gone, with the reason.
    fn report(&mut self) -> anyhow::Result<()> {
        let worker = self.feed.worker();
        if worker == self.reported {
            return Ok(());
        }
        let event = match worker {
            Worker::Alive | Worker::Stale => None,
            Worker::Gone => Some(WakeEvent::Ended),
            Worker::Unknown => Some(WakeEvent::Unreachable),
        };
        if let Some(event) = event {
            self.worker_ports.planners.wake(event)?;
        }
        self.reported = worker;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_older_term_is_fenced_until_nobody_has_sent_in_the_later_one_for_longer_than_a_lease_lasts()
     {
        let mut highest = HighestTerm::default();
        assert!(!highest.observe_frame(0, 1), "of the only worker");
        assert!(highest.observe_frame(3, 5));
        for (term, now_ns) in [(3, 6), (2, 7), (0, 8)] {
            assert!(!highest.observe_frame(term, now_ns));
            assert_eq!(highest.at(now_ns), 3);
        }
        assert!(highest.observe_frame(4, 9));
        // A frame of an earlier term does not extend the fence.
        let later_ns = 9 + TERM_TIMEOUT_NS;
        assert!(!highest.observe_frame(3, later_ns));
        assert_eq!(highest.at(later_ns), 4);
        assert_eq!(highest.at(later_ns + 1), 0);
        assert!(highest.observe_frame(1, later_ns + 1));
        assert_eq!(highest.at(later_ns + 2), 1);
    }

    #[test]
    fn a_term_is_remembered_while_its_worker_serves_however_rarely_its_frames_come() {
        let mut highest = HighestTerm::default();
        assert!(highest.observe_frame(3, 0));
        // Statuses come ten times a second, but no frame for an hour.
        for now_ns in (0..3_600_000_000_000).step_by(100_000_000) {
            highest.observe_leader(3, now_ns);
            // The status of an earlier term neither extends the fence nor removes it.
            highest.observe_leader(2, now_ns);
            assert_eq!(highest.at(now_ns), 3);
        }
        let last_ns = 3_600_000_000_000 - 100_000_000;
        assert!(!highest.observe_frame(2, last_ns + TERM_TIMEOUT_NS));
        assert_eq!(highest.at(last_ns + TERM_TIMEOUT_NS + 1), 0);
        // A status does not restore a term that has timed out.
        for term in [3, 0] {
            highest.observe_leader(term, last_ns + TERM_TIMEOUT_NS + 1);
        }
        assert_eq!(highest.at(last_ns + TERM_TIMEOUT_NS + 1), 0);
    }
}
