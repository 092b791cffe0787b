//! The threads of a host whose worker is one of several candidates. One thread holds the lease, one
//! follows the other candidates.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::thread;
use std::time::Duration;

use anyhow::Context as _;
use joulebus_bus::{Domain, WorkerLock, clock};
use joulebus_config::Config;
use joulebus_standby::{Permit, SavedState};
use joulebus_wire::StateHeader;

use crate::config::{LeaseSettings, Settings, Standby};
use crate::etcd::Etcd;
use crate::network::{Event, Inbox, Kind, Network, longest_state_bytes};
use crate::protocol::carried::Carried;
use crate::protocol::lease::{Candidate, Next, Right};
use crate::protocol::message::Worker;
use crate::protocol::receiver::Accepted;
use crate::protocol::selection::Selection;
use crate::protocol::shift::shift;
use crate::taking::{TakenRecord, Taking};
use crate::turn::Turn;

/// Maximum sleep: the delay until a stop, a request or a later term is noticed.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Interval of checks whether the worker lives.
const WORKER_EVERY_NS: u64 = 200_000_000;
/// Time after which an absent worker is not expected back. A leader that has sent nothing for
/// `HANGS_NS` and for `HANGS_TICKS` ticks hangs.
const AWAY_NS: u64 = 2_000_000_000;
const HANGS_NS: u64 = 5_000_000_000;
const HANGS_TICKS: u64 = 5;
/// Nanoseconds in a second.
const NANOSECONDS: u64 = 1_000_000_000;

/// Holds the lease, or waits for it, until `stop`.
///
/// # Errors
/// A file that the settings name cannot be read.
pub(crate) fn hold(
    (config, settings): (&Config, &Settings),
    (standby, lease): (&Standby, &LeaseSettings),
    (turn, permit): (&Turn, Option<Permit>),
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<()> {
    let mut etcd = Etcd::new(lease, (config.fleet(), &standby.shard, &settings.name))?;
    let right = permit.and_then(|permit| {
        let until_ns = permit.until_ns?;
        let (term, lease) = (permit.term, permit.lease);
        Some(Right {
            term,
            until_ns,
            lease,
        })
    });
    if right.is_none() {
        // An operator's permit, from a time without a lease.
        turn.withdraw()?;
    }
    let ttl_ns = u64::from(lease.ttl_s) * NANOSECONDS;
    let mut candidate = Candidate::new(&settings.name, standby.rank, ttl_ns, right);
    let mut holding = Holding { turn, right };
    let mut holder = None;
    let hangs_ns = HANGS_NS.max(HANGS_TICKS * config.tick_period_ns());
    let mut worker = HostsWorker::new(config.domain()?, hangs_ns);
    ready();
    while !stop.load(Ordering::Relaxed) {
        candidate.hears(turn.heard());
        candidate.is_able(worker.is_able(turn));
        // Boot time counts suspension: a lease also ends while this host is suspended.
        let now_ns = clock::boot_ns();
        match candidate.next(now_ns) {
            Next::Wait(until_ns) => {
                thread::sleep(
                    LOOK_EVERY.min(Duration::from_nanos(until_ns.saturating_sub(now_ns))),
                );
            }
            Next::Call(call) => {
                let asked_ns = clock::boot_ns();
                let reply = etcd.call(&call);
                candidate.answered(&call, reply, (asked_ns, clock::boot_ns()));
            }
        }
        holding.follow(candidate.right(clock::boot_ns()));
        let found = candidate.holder().map(|it| it.name.clone());
        if found != holder {
            match &found {
                Some(name) => tracing::info!("etcd: shard {} is held by {name}", standby.shard),
                None => tracing::info!("etcd: shard {} is held by nobody", standby.shard),
            }
            holder = found;
        }
    }
    Ok(())
}

/// Whether the worker of this host can lead.
struct HostsWorker {
    domain: Domain,
    hangs_ns: u64,
    look_ns: u64,
    /// When its lock was last seen held, monotonic ns.
    seen_ns: Option<u64>,
    is_able: bool,
}

impl HostsWorker {
    const fn new(domain: Domain, hangs_ns: u64) -> Self {
        Self {
            domain,
            hangs_ns,
            look_ns: 0,
            seen_ns: None,
            is_able: false,
        }
    }

    /// Whether the worker lives and, as leader, sends. A worker that restarts counts as able for a
    /// while.
    fn is_able(&mut self, turn: &Turn) -> bool {
        let now_ns = clock::monotonic_ns();
        if now_ns >= self.look_ns {
            self.look_ns = now_ns + WORKER_EVERY_NS;
            match WorkerLock::owner(&self.domain) {
                Ok(Some(_)) => self.seen_ns = Some(now_ns),
                Ok(None) => {}
                Err(error) => tracing::debug!(%error, "the worker's lock cannot be read"),
            }
            let away_ns = self.seen_ns.map(|seen_ns| now_ns - seen_ns);
            let hangs = turn.term() > 0 && turn.idle_ns() > self.hangs_ns;
            let is_able = away_ns.is_some_and(|away_ns| away_ns <= AWAY_NS) && !hangs;
            if self.is_able && !is_able {
                let what = if hangs { "sends nothing" } else { "is gone" };
                tracing::warn!("the worker of this host {what}: another may serve");
            }
            self.is_able = is_able;
        }
        self.is_able
    }
}

/// Writes the worker's permit as the lease changes.
struct Holding<'a> {
    turn: &'a Turn,
    right: Option<Right>,
}

impl Holding<'_> {
    fn follow(&mut self, right: Option<Right>) {
        if right == self.right {
            return;
        }
        let done = match right {
            Some(right) => self.turn.grant(&Permit {
                term: right.term,
                until_ns: Some(right.until_ns),
                lease: right.lease,
            }),
            None => self.turn.withdraw(),
        };
        match (done, self.right, right) {
            // The permit is written again with the next renewal.
            (Err(error), ..) => {
                tracing::error!("{error}");
                return;
            }
            (Ok(()), before, Some(now)) if before.is_none_or(|it| it.term != now.term) => {
                tracing::info!("this host serves, term {}", now.term);
            }
            (Ok(()), Some(before), None) => {
                tracing::warn!(
                    "this host no longer serves: its lease of term {} is over",
                    before.term
                );
            }
            _ => {}
        }
        self.right = right;
    }
}

/// Follows the other candidates until `stop`.
///
/// It keeps the leader's state for this host's worker and notices leaders of later terms. Without a
/// lease it executes the operator's requests.
///
/// # Errors
/// The network is refused.
pub(crate) fn follow(
    (config, settings, standby): (&Config, &Settings, &Standby),
    (network, turn): (&Arc<Network>, &Turn),
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<Vec<TakenRecord>> {
    let capacity = config.limits().capacity;
    let mut inbox = Inbox::new(longest_state_bytes(capacity));
    let mut others = Vec::new();
    for (rank, other) in &standby.others {
        let of_fleet = (settings.fleet(config), capacity);
        let selection = Selection::new(0, 1, Vec::new());
        let from = (Kind::Outputs, other.as_str());
        let taking = Taking::open(network, from, of_fleet, selection, &mut inbox)?;
        others.push((*rank, taking));
    }
    let mut following = Following {
        turn,
        others,
        rank: standby.rank,
        is_by_hand: standby.lease.is_none(),
        claim: 0,
    };
    ready();
    while !stop.load(Ordering::Relaxed) {
        following.turn(&inbox)?;
    }
    let records = following.others.iter().map(|(_, taking)| taking.record());
    let mut records: Vec<TakenRecord> = records.collect();
    if let Some(first) = records.first_mut() {
        first.received.lost += inbox.overflowed();
    }
    Ok(records)
}

struct Following<'a> {
    turn: &'a Turn,
    /// The other candidates' streams with their ranks.
    others: Vec<(usize, Taking)>,
    rank: usize,
    /// An operator chooses the leader.
    is_by_hand: bool,
    /// The term in which this host leads by request once no other candidate does. 0 without a
    /// request.
    claim: u64,
}

impl Following<'_> {
    fn turn(&mut self, inbox: &Inbox) -> anyhow::Result<()> {
        let services = match self.turn.term() {
            0 => Carried::STATE.bit(),
            _ => 0,
        };
        for (_, taking) in &mut self.others {
            taking.receiver().select(services);
            taking.ask();
        }
        match inbox.next(LOOK_EVERY) {
            Ok(Event::Message {
                from,
                bytes,
                arrived_ns,
            }) => {
                let turn = self.turn;
                let taking = self.others.iter_mut().find(|(_, it)| *it.from() == *from);
                if let Some((rank, taking)) = taking {
                    taking.message(&bytes, arrived_ns, |accepted| {
                        keep(turn, &accepted).map_err(|error| ("not kept", format!("{error:#}")))
                    });
                    let (rank, receiver) = (*rank, taking.receiver());
                    let (term, heard) = (receiver.term(), receiver.heard_term());
                    self.hears(rank, (term, heard))?;
                }
            }
            Ok(Event::Lost { name }) => {
                for (_, taking) in self.others.iter_mut().filter(|(_, it)| *it.from() == *name) {
                    taking.receiver().lost();
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
        let now_ns = clock::monotonic_ns();
        for (_, taking) in &mut self.others {
            if taking.receiver().falls_silent(now_ns) {
                tracing::warn!("nothing comes from {}", taking.from());
            }
        }
        if self.is_by_hand {
            self.obey()?;
        }
        Ok(())
    }

    /// Handles what the candidate of this rank reports: `term`, in which it leads (0 if it does
    /// not), and the highest term that it knows of or claims.
    fn hears(&self, rank: usize, (term, heard): (u64, u64)) -> anyhow::Result<()> {
        let own = self.turn.term();
        self.turn.hear(heard);
        // If operators permitted two candidates the same term, the first in the list stays. A lease
        // permits a term to one candidate, and its thread notices later terms by itself.
        let gives_way = heard > own || (term == own && rank < self.rank);
        if own > 0 && gives_way && self.is_by_hand {
            tracing::warn!(
                "another worker is to serve in term {heard}: this host's, of term {own}, ends"
            );
            self.turn.withdraw()?;
        }
        Ok(())
    }

    /// Executes an operator's request: claims the next term, and leads once the other candidates
    /// that are connected have given way.
    ///
    /// A candidate out of reach may still lead for the hosts beside it. Only a lease prevents that.
    fn obey(&mut self) -> anyhow::Result<()> {
        let request = &self.turn.places().request;
        if !request.exists() {
            self.claim = 0;
            return Ok(());
        }
        if self.turn.term() == 0 {
            if self.claim == 0 || self.claim < self.turn.heard() {
                let heard = self.turn.heard();
                let Some(claim) = heard.checked_add(1) else {
                    tracing::error!(
                        "after term {heard} there is none: stop all links of this shard, and start them again"
                    );
                    return remove(request);
                };
                self.claim = claim;
                self.turn.hear(self.claim);
            }
            let speaks = |(_, taking): &mut (usize, Taking)| {
                let receiver = taking.receiver();
                receiver.is_heard() && (receiver.term() > 0 || receiver.worker() == Worker::Alive)
            };
            if self.others.iter_mut().any(speaks) {
                return Ok(());
            }
            self.turn.grant(&Permit {
                term: self.claim,
                until_ns: None,
                lease: 0,
            })?;
            tracing::warn!("by command this host serves, term {}", self.claim);
        }
        remove(request)
    }
}

fn remove(request: &Path) -> anyhow::Result<()> {
    std::fs::remove_file(request).with_context(|| format!("{request:?}"))
}

/// Saves the leader's state for the worker of this host.
fn keep(turn: &Turn, accepted: &Accepted<'_>) -> anyhow::Result<()> {
    let frame = &accepted.frame;
    if frame.service != Carried::STATE || turn.term() > 0 {
        return Ok(());
    }
    let mut header: StateHeader = frame.header();
    shift(&mut header, accepted.offset_ns);
    let bytes = frame.bytes();
    anyhow::ensure!(
        header.offset == 0 && header.total_bytes == bytes.len() as u64,
        "{} bytes of a state of {} from byte {}",
        bytes.len(),
        header.total_bytes,
        header.offset
    );
    let ahead_ns = header.taken_ns.saturating_sub(clock::monotonic_ns());
    anyhow::ensure!(ahead_ns == 0, "a state was taken {ahead_ns} ns from now");
    anyhow::ensure!(
        accepted.term > 0 && accepted.term >= turn.heard(),
        "a state of term {}, although one serves, or has, in term {}",
        accepted.term,
        turn.heard()
    );
    let offset_ns = i64::try_from(accepted.offset_ns).context("the clocks are too far apart")?;
    let of = (accepted.term, header.taken_ns, offset_ns);
    SavedState::write(&turn.places().replica, of, bytes)?;
    Ok(())
}
