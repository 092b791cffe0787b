//! The threads of a host whose worker is one of several candidates. One thread holds the lease, one
//! follows the other candidates.

use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use anyhow::Context as _;
use joulebus_bus::{Domain, Rounds, WorkerLock, clock};
use joulebus_connect::standby::{Permit, SavedState};
use joulebus_wire::StateHeader;

use crate::config::Standby;
use crate::etcd::Etcd;
use crate::ingress::{self, Ingress};
use crate::leadership::Leadership;
use crate::network::{Event, Inbox, NetworkError};
use crate::protocol::carried::{Carried, Kind, max_state_message_bytes};
use crate::protocol::lease::{Candidate, IdleTimeouts, LeaderLease, LocalWorker, Next};
use crate::protocol::receiver::Accepted;
use crate::protocol::selection::Selection;
use crate::protocol::shift::shift;
use crate::report::Done;
use crate::shared::Shared;

/// Maximum sleep: the delay until a stop or a later term is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Interval of checks whether the worker lives.
const WORKER_POLL_INTERVAL_NS: u64 = 200_000_000;
/// Nanoseconds in a second.
const NANOSECONDS: u64 = 1_000_000_000;

/// Holds the lease, or waits for it.
pub(crate) struct Candidacy {
    leadership: Arc<Leadership>,
    etcd: Etcd,
    candidate: Candidate,
    permit_writer: PermitWriter,
    /// The holder that was logged last.
    holder: Option<String>,
    worker: WorkerWatch,
}

impl Candidacy {
    /// # Errors
    /// A file that the settings name cannot be read.
    pub(crate) fn open(
        shared: &Shared,
        leadership: Arc<Leadership>,
        standby: &Standby,
        permit: Option<Permit>,
    ) -> anyhow::Result<Self> {
        let Shared { config, settings, .. } = shared;
        let lease = &standby.lease;
        let etcd = Etcd::new(lease, (config.fleet(), &settings.name))?;
        let leader_lease =
            permit.map(|Permit { term, until_ns, lease }| LeaderLease { term, until_ns, lease });
        let ttl_ns = u64::from(lease.ttl_s) * NANOSECONDS;
        let timeouts = IdleTimeouts::new(ttl_ns, config.tick_period_ns());
        Ok(Self {
            leadership,
            etcd,
            candidate: Candidate::new(&settings.name, standby.rank, ttl_ns, leader_lease),
            permit_writer: PermitWriter { leader_lease },
            holder: None,
            worker: WorkerWatch::new(config.domain()?, timeouts),
        })
    }
}

impl Rounds<Done, anyhow::Error> for Candidacy {
    fn round(&mut self) -> anyhow::Result<Duration> {
        let Self { leadership, etcd, candidate, permit_writer, holder, worker } = self;
        candidate.observe_term(leadership.highest_term());
        worker.look(leadership);
        candidate.is_able(worker.is_able);
        candidate.is_idle(worker.is_idle);
        // Boot time counts suspension: a lease also ends while this host is suspended.
        let now_ns = clock::boot_ns();
        let pause = match candidate.next(now_ns) {
            Next::Wait(until_ns) => {
                POLL_INTERVAL.min(Duration::from_nanos(until_ns.saturating_sub(now_ns)))
            }
            Next::Call(call) => {
                let asked_ns = clock::boot_ns();
                let reply = etcd.call(&call);
                candidate.answered(&call, reply, (asked_ns, clock::boot_ns()));
                Duration::ZERO
            }
        };
        permit_writer.follow(leadership, candidate.leader_lease(clock::boot_ns()));
        let found = candidate.holder().map(|holder| holder.name.clone());
        if found != *holder {
            match &found {
                Some(name) => tracing::info!("etcd: {name} holds the lease"),
                None => tracing::info!("etcd: nobody holds the lease"),
            }
            *holder = found;
        }
        Ok(pause)
    }

    fn finish(self) -> anyhow::Result<Done> {
        Ok(Done::default())
    }
}

/// Watches whether this host's worker can lead.
struct WorkerWatch {
    domain: Domain,
    timeouts: IdleTimeouts,
    look_ns: u64,
    /// Term in which it led at the last check.
    term: u64,
    /// When its lock was last seen held, monotonic ns.
    seen_ns: Option<u64>,
    /// The process that held its lock at the last check, if that is visible here.
    pid: Option<u32>,
    has_outlived_permit: bool,
    is_able: bool,
    is_idle: bool,
}

impl WorkerWatch {
    const fn new(domain: Domain, timeouts: IdleTimeouts) -> Self {
        Self {
            domain,
            timeouts,
            look_ns: 0,
            term: 0,
            seen_ns: None,
            pid: None,
            has_outlived_permit: false,
            is_able: false,
            is_idle: false,
        }
    }

    fn look(&mut self, leadership: &Leadership) {
        let (now_ns, term) = (clock::monotonic_ns(), leadership.term());
        // Check at once when a term ends: the lease may already be free again.
        if now_ns >= self.look_ns || term != self.term {
            (self.look_ns, self.term) = (now_ns + WORKER_POLL_INTERVAL_NS, term);
            self.look_for_process(now_ns, leadership);
        }
        let worker = self.worker(now_ns, leadership);
        let is_idle = worker.is_idle(self.timeouts);
        if is_idle && !self.is_idle {
            tracing::warn!(
                "the worker of this host sends nothing: its lease is not renewed until it does"
            );
        }
        self.is_idle = is_idle;
        let defect = worker.defect();
        if self.is_able
            && let Some(what) = defect
        {
            tracing::warn!("the worker of this host {what}: another may take over");
        }
        self.is_able = defect.is_none();
    }

    /// Looks at the worker's lock and permit.
    fn look_for_process(&mut self, now_ns: u64, leadership: &Leadership) {
        self.has_outlived_permit = leadership.has_ended_permit();
        match WorkerLock::owner(&self.domain) {
            Ok(Some(owner)) => {
                self.seen_ns = Some(now_ns);
                if owner.pid.is_some() && owner.pid != self.pid {
                    self.pid = owner.pid;
                    leadership.worker_starts();
                }
            }
            Ok(None) => {}
            Err(error) => tracing::debug!(%error, "the worker's lock cannot be read"),
        }
    }

    fn worker(&self, now_ns: u64, leadership: &Leadership) -> LocalWorker {
        LocalWorker {
            away_ns: self.seen_ns.map(|seen_ns| now_ns - seen_ns),
            term: self.term,
            idle_ns: leadership.idle_ns(),
            has_sent: leadership.has_sent(),
            has_outlived_permit: self.has_outlived_permit,
        }
    }
}

/// Writes the worker's permit as the lease changes.
struct PermitWriter {
    leader_lease: Option<LeaderLease>,
}

impl PermitWriter {
    fn follow(&mut self, leadership: &Leadership, leader_lease: Option<LeaderLease>) {
        if leader_lease == self.leader_lease {
            return;
        }
        let done = match (leader_lease, self.leader_lease) {
            (Some(leader_lease), _) => leadership.grant(&Permit {
                term: leader_lease.term,
                until_ns: leader_lease.until_ns,
                lease: leader_lease.lease,
            }),
            (None, Some(before)) => leadership.end(before.term),
            (None, None) => Ok(()),
        };
        match (done, self.leader_lease, leader_lease) {
            // The permit is written again with the next renewal.
            (Err(error), ..) => {
                tracing::error!("{error}");
                return;
            }
            (Ok(()), before, Some(now)) if before.is_none_or(|holder| holder.term != now.term) => {
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
        self.leader_lease = leader_lease;
    }
}

/// Follows the other candidates.
///
/// It keeps the leader's state for this host's worker and notices leaders of later terms.
pub(crate) struct Rivals {
    leadership: Arc<Leadership>,
    inbox: Inbox,
    /// The other candidates' streams.
    others: Vec<Ingress>,
}

impl Rounds<Done, anyhow::Error> for Rivals {
    fn round(&mut self) -> anyhow::Result<Duration> {
        let services = match self.leadership.term() {
            0 => Carried::STATE.bit(),
            _ => 0,
        };
        for ingress in &mut self.others {
            ingress.receiver().select(services);
            ingress.request_if_due();
        }
        match self.inbox.next(POLL_INTERVAL) {
            Ok(Event::Message { from, bytes, arrived_ns }) => {
                let leadership = &self.leadership;
                let ingress = self.others.iter_mut().find(|ingress| *ingress.from() == *from);
                if let Some(ingress) = ingress {
                    ingress.message(&bytes, arrived_ns, |accepted| {
                        keep(leadership, &accepted)
                            .map_err(|error| ("not kept", format!("{error:#}")))
                    });
                    leadership.observe_term(ingress.receiver().highest_term());
                }
            }
            Ok(Event::Lost { name }) => {
                for ingress in self.others.iter_mut().filter(|other| *other.from() == *name) {
                    ingress.receiver().lost();
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
        let now_ns = clock::monotonic_ns();
        for ingress in &mut self.others {
            if ingress.receiver().becomes_silent(now_ns) {
                tracing::warn!("nothing comes from {}", ingress.from());
            }
        }
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<Done> {
        Ok(ingress::finish(self.others.iter(), &self.inbox))
    }
}

impl Rivals {
    pub(crate) fn open(
        shared: &Shared,
        leadership: Arc<Leadership>,
        standby: &Standby,
    ) -> Result<Self, NetworkError> {
        let capacity = shared.config.limits().capacity;
        let mut inbox = Inbox::new(max_state_message_bytes(capacity));
        let mut others = Vec::new();
        for other in &standby.others {
            let selection = Selection::new(0, 1, Vec::new());
            let from = (Kind::Outputs, other.as_str());
            others.push(Ingress::open(shared, from, capacity, selection, &mut inbox)?);
        }
        Ok(Self { leadership, inbox, others })
    }
}

/// Saves the leader's state for the worker of this host.
fn keep(leadership: &Leadership, accepted: &Accepted<'_>) -> anyhow::Result<()> {
    let frame = &accepted.frame;
    if frame.service != Carried::STATE || leadership.term() > 0 {
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
        accepted.term > 0 && accepted.term >= leadership.highest_term(),
        "a state of term {}, although one serves, or has, in term {}",
        accepted.term,
        leadership.highest_term()
    );
    let offset_ns = i64::try_from(accepted.offset_ns).context("the clocks are too far apart")?;
    let of = (accepted.term, header.taken_ns, offset_ns);
    SavedState::write(&leadership.places().replica, of, bytes)?;
    Ok(())
}
