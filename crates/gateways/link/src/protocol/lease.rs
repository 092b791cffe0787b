//! Leader election for a fleet over an etcd lease, as a pure state machine. It yields the next
//! call to the store and handles the replies. Time is an argument.
//!
//! The store has two keys. The *holder* disappears with its lease. The *term* stays and only grows.
//! A candidate leads while the holder's key has its lease.
//!
//! The store ends a lease when the time to live has passed since it processed the last renewal.
//! This host sent that renewal earlier. It counts from the sending, less the possible drift between
//! the two clocks, and so stops leading before another candidate can. That needs no reply
//! and no time of another host.
//!
//! The next term is one more than the store's term and than any term that this host knows of. It is
//! therefore higher than all earlier terms, even if the store has lost its data or a candidate has
//! led without it.

/// Possible drift between two clocks as a share of the time to live. `chrony` slews a clock by up
/// to 83,333 ppm by default (`maxslewrate`), and a crystal is within 100 ppm of its frequency. If
/// this host's clock is that slow and the store's that fast, they differ by 15.4 %.
/// `DRIFT_MARGIN_NS` is added for rounding.
const DRIFT_DIVISOR: u64 = 6;
const DRIFT_MARGIN_NS: u64 = 10_000_000;
/// Renewals per time to live. One or two may be lost.
const RENEWALS: u64 = 5;
/// Polls of the store per time to live while another candidate leads, and the minimum and maximum
/// interval.
const LOOKS: u64 = 10;
const POLL_INTERVAL_NS: (u64, u64) = (100_000_000, 500_000_000);
/// Maximum time to live of a lease, s. The file cannot ask for more, and a longer one that the
/// store grants is cut to it.
pub(crate) const MAX_TTL_S: u32 = 60;
const MAX_TTL_NS: u64 = MAX_TTL_S as u64 * 1_000_000_000;
/// Time that a candidate needs to take the lead after it has seen that nobody holds it: two calls to the store. A
/// candidate waits so long, and one interval of polls, for each candidate before it in the list.
const ACQUISITION_NS: u64 = 200_000_000;
/// A leader that sends nothing for this share of the time to live, and for so many ticks, is idle.
/// Its lease is not renewed until it sends again. The rest of the lease lasts for longer than the
/// other half. So a worker that pauses for less than the time to live loses nothing.
const IDLE_DIVISOR: u64 = 2;
const IDLE_TICKS: u64 = 5;
/// Minimum time for a leader to start, restore a state, and send.
const START_TIMEOUT_NS: u64 = 5_000_000_000;
/// Time after which an absent worker is not expected back.
const RESTART_TIMEOUT_NS: u64 = 2_000_000_000;

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct StoreView {
    pub(crate) holder: Option<Holder>,
    /// The last term. 0 before the first.
    pub(crate) term: u64,
    /// The store's revision of the term's key, 0 if there is none. It changes with the term.
    pub(crate) term_revision: u64,
}

/// The candidate that leads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Holder {
    pub(crate) name: String,
    pub(crate) term: u64,
    pub(crate) lease: u64,
}

/// A call to the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Call {
    /// Grants a new lease.
    Grant,
    Look,
    /// Makes this candidate the holder and sets the term, if there is no holder and the term's key
    /// still has this revision.
    Acquire {
        lease: u64,
        term: u64,
        term_revision: u64,
    },
    Renew {
        lease: u64,
    },
    /// Gives the lease back. It would end by itself a little later.
    Release {
        lease: u64,
    },
}

/// The store's reply to a call.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Reply {
    Granted {
        lease: u64,
        ttl_ns: u64,
    },
    StoreView(StoreView),
    /// True if this candidate has become the holder.
    Acquired(bool),
    /// A time to live of 0 means that the lease is gone.
    Renewed {
        ttl_ns: u64,
    },
    /// There is no such lease, or no longer.
    Gone,
    /// No reply in time, or an unintelligible one. The store may have executed the call.
    Failed,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Next {
    Call(Call),
    /// Nothing before this instant.
    Wait(u64),
}

/// The right to lead in a term, while a lease lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LeaderLease {
    pub(crate) term: u64,
    /// When another candidate may lead, ns since boot including suspension.
    pub(crate) until_ns: u64,
    pub(crate) lease: u64,
}

/// A lease with a lower bound of its end.
#[derive(Debug, Clone, Copy)]
struct Lease {
    id: u64,
    until_ns: u64,
}

/// Time without a frame after which a leader counts as idle, ns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IdleTimeouts {
    /// Timeout of a leader that sends.
    sending_ns: u64,
    /// Timeout of a leader that has not sent yet.
    starting_ns: u64,
}

impl IdleTimeouts {
    /// The timeouts for a lease and the period of the ticks.
    pub(crate) fn new(ttl_ns: u64, period_ns: u64) -> Self {
        let sending_ns = (ttl_ns / IDLE_DIVISOR).max(IDLE_TICKS * period_ns);
        Self { sending_ns, starting_ns: sending_ns.max(START_TIMEOUT_NS) }
    }
}

/// This host's worker, as its link sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalWorker {
    /// Time since its lock was last seen held, ns. `None` if it never was.
    pub(crate) away_ns: Option<u64>,
    /// Term in which it leads. 0 if it does not.
    pub(crate) term: u64,
    /// Time since it last sent, started or was permitted to lead, ns.
    pub(crate) idle_ns: u64,
    /// It has sent since it started and was permitted to lead. Before, it may load its models and
    /// restore a state.
    pub(crate) has_sent: bool,
    /// Its permit has ended, and it is still there. A worker ends with its permit, and the next one
    /// removes what is left of it. So this process hangs.
    pub(crate) has_outlived_permit: bool,
}

impl LocalWorker {
    /// True if it leads and works too little: it may hang.
    pub(crate) const fn is_idle(&self, timeouts: IdleTimeouts) -> bool {
        let timeout_ns = if self.has_sent { timeouts.sending_ns } else { timeouts.starting_ns };
        self.term > 0 && self.idle_ns > timeout_ns
    }

    /// Why it cannot lead. `None` if it can. A worker that restarts counts as able for a while.
    pub(crate) fn defect(&self) -> Option<&'static str> {
        if self.has_outlived_permit {
            return Some("has not been started again since its permit ended");
        }
        let is_here = self.away_ns.is_some_and(|away_ns| away_ns <= RESTART_TIMEOUT_NS);
        (!is_here).then_some("is gone")
    }
}

/// One candidate's view of the election.
#[derive(Debug, Default)]
pub(crate) struct Candidate {
    name: String,
    /// Position in the list of candidates. The first one takes a free lease first.
    rank: u64,
    ttl_ns: u64,
    lease: Option<Lease>,
    /// Term in which this candidate leads.
    term: Option<u64>,
    /// The lead is being given up: the lease is not renewed and runs out.
    resigns: bool,
    /// A lease that was given up, and whose permit has ended.
    released: Option<u64>,
    /// The worker of this host can lead.
    is_able: bool,
    /// It leads and sends nothing: the lease is not renewed.
    is_idle: bool,
    /// Highest term that any candidate is known to have led in.
    highest_term: u64,
    /// When this candidate first saw that nobody leads.
    free_since_ns: Option<u64>,
    view: StoreView,
    look_ns: u64,
    renew_ns: u64,
}

impl Candidate {
    /// Creates a candidate. `leader_lease` is set after a restart of the link, which then continues
    /// as leader.
    pub(crate) fn new(
        name: &str,
        rank: usize,
        ttl_ns: u64,
        leader_lease: Option<LeaderLease>,
    ) -> Self {
        Self {
            name: name.to_owned(),
            rank: rank as u64,
            ttl_ns,
            lease: leader_lease.map(|leader_lease| Lease {
                id: leader_lease.lease,
                until_ns: leader_lease.until_ns,
            }),
            term: leader_lease.map(|leader_lease| leader_lease.term),
            is_able: true,
            ..Self::default()
        }
    }

    /// The right to lead at `now_ns`.
    pub(crate) fn leader_lease(&self, now_ns: u64) -> Option<LeaderLease> {
        let (own, term) = (self.lease?, self.term?);
        (now_ns < own.until_ns && term >= self.highest_term).then_some(LeaderLease {
            term,
            until_ns: own.until_ns,
            lease: own.id,
        })
    }

    /// Notes a term in which a candidate leads or has led.
    pub(crate) fn observe_term(&mut self, term: u64) {
        self.highest_term = self.highest_term.max(term);
    }

    /// Sets whether the worker of this host can lead. If not, the candidate takes no lead and gives
    /// up the one that it has.
    pub(crate) fn is_able(&mut self, is_able: bool) {
        self.is_able = is_able;
        self.resigns |= !is_able;
    }

    /// Sets whether the worker of this host leads and sends nothing. The lease is renewed again if
    /// the worker sends before its end.
    pub(crate) const fn is_idle(&mut self, is_idle: bool) {
        self.is_idle = is_idle;
    }

    /// The holder in the last view of the store.
    pub(crate) fn holder(&self) -> Option<&Holder> {
        self.view.holder.as_ref()
    }

    /// Next step at `now_ns`.
    pub(crate) fn next(&mut self, now_ns: u64) -> Next {
        if self.is_over(now_ns) {
            let is_given_up = self.resigns || self.is_idle;
            let ended = self.lease.filter(|own| is_given_up && now_ns >= own.until_ns);
            self.released = ended.map(|own| own.id);
            self.ends();
        }
        if let Some(lease) = self.released.take() {
            return Next::Call(Call::Release { lease });
        }
        if self.term.is_some() {
            return self.next_of_holder(now_ns);
        }
        let turn_ns = self.turn_ns();
        let is_turn = turn_ns.is_some_and(|turn_ns| now_ns >= turn_ns);
        if now_ns < self.look_ns && !is_turn {
            return Next::Wait(turn_ns.unwrap_or(u64::MAX).min(self.look_ns));
        }
        // The term would overflow. Prefer no leader to two leaders in one term.
        if is_turn && let Some(term) = self.view.term.max(self.highest_term).checked_add(1) {
            return match self.lease.filter(|own| now_ns < own.until_ns) {
                Some(own) => Next::Call(Call::Acquire {
                    lease: own.id,
                    term,
                    term_revision: self.view.term_revision,
                }),
                None => Next::Call(Call::Grant),
            };
        }
        Next::Call(Call::Look)
    }

    /// True if the lease has run out or another candidate leads in a later term. This candidate
    /// then starts again, whatever the store holds.
    fn is_over(&self, now_ns: u64) -> bool {
        self.term.is_some() && self.leader_lease(now_ns).is_none()
    }

    fn next_of_holder(&self, now_ns: u64) -> Next {
        let renews = (!self.resigns && !self.is_idle).then_some(self.renew_ns);
        if renews.is_some_and(|due_ns| now_ns >= due_ns)
            && let Some(own) = self.lease
        {
            return Next::Call(Call::Renew { lease: own.id });
        }
        if now_ns >= self.look_ns {
            return Next::Call(Call::Look);
        }
        Next::Wait(renews.unwrap_or(u64::MAX).min(self.look_ns))
    }

    /// When this candidate may take the lead. `None` if it may not.
    ///
    /// It does not wait for its next poll. A candidate further down the list waits until all before
    /// it have polled once more and made their calls. So the first that is able leads.
    fn turn_ns(&self) -> Option<u64> {
        let since_ns = self.free_since_ns.filter(|_| self.is_able)?;
        let behind_ns = self.rank * (self.poll_interval_ns() + ACQUISITION_NS);
        Some(since_ns.saturating_add(behind_ns))
    }

    fn poll_interval_ns(&self) -> u64 {
        let (least_ns, most_ns) = POLL_INTERVAL_NS;
        (self.ttl_ns / LOOKS).clamp(least_ns, most_ns)
    }

    /// Handles the reply to a call that was made at `asked_ns` and replied to, or given up, at
    /// `now_ns`.
    pub(crate) fn answered(&mut self, call: &Call, reply: Reply, (asked_ns, now_ns): (u64, u64)) {
        match (call, reply) {
            // Lease 0 is no lease: a key stored with it would never expire. A lease that has
            // already run out is requested again later.
            (Call::Grant, Reply::Granted { lease, ttl_ns })
                if lease > 0 && until(asked_ns, ttl_ns) > now_ns =>
            {
                self.lease = Some(Lease { id: lease, until_ns: until(asked_ns, ttl_ns) });
            }
            (Call::Look, Reply::StoreView(view)) => self.observe_store(view, now_ns),
            (Call::Acquire { term, .. }, Reply::Acquired(true)) => {
                self.term = Some(*term);
                self.resigns = !self.is_able;
                self.free_since_ns = None;
                self.renew_ns = now_ns;
            }
            (Call::Acquire { .. }, Reply::Acquired(false)) => {
                // Another candidate was faster.
                self.free_since_ns = None;
                self.look_ns = now_ns;
            }
            (Call::Renew { lease }, Reply::Renewed { ttl_ns }) => {
                self.renewed(*lease, ttl_ns, (asked_ns, now_ns));
            }
            // A lease that was thought to last, and does not: begin anew with another.
            (Call::Acquire { .. } | Call::Renew { .. }, Reply::Gone) => self.ends(),
            // Retry soon. After a failed acquisition the next look shows whether it took effect.
            (call, _) => {
                let soon_ns = now_ns + POLL_INTERVAL_NS.0;
                match call {
                    Call::Renew { .. } => self.renew_ns = soon_ns,
                    _ => (self.look_ns, self.free_since_ns) = (soon_ns, None),
                }
            }
        }
    }

    fn observe_store(&mut self, view: StoreView, now_ns: u64) {
        self.look_ns = now_ns + self.poll_interval_ns();
        let own = self.lease.map(|own| own.id);
        let held = view.holder.as_ref();
        match held.filter(|holder| Some(holder.lease) == own && holder.name == self.name) {
            Some(holder) => {
                if self.term != Some(holder.term) {
                    // The reply to the acquisition was lost.
                    self.term = Some(holder.term);
                    self.resigns = !self.is_able;
                    self.renew_ns = now_ns;
                }
                self.free_since_ns = None;
            }
            None => {
                // The holder's key may also have been removed by hand.
                self.term = None;
                self.free_since_ns = match held {
                    None => Some(self.free_since_ns.unwrap_or(now_ns)),
                    Some(_) => None,
                };
            }
        }
        self.view = view;
    }

    fn renewed(&mut self, lease: u64, ttl_ns: u64, (asked_ns, now_ns): (u64, u64)) {
        let Some(own) = self.lease.as_mut().filter(|own| own.id == lease) else {
            return;
        };
        if ttl_ns == 0 {
            self.ends();
            return;
        }
        own.until_ns = own.until_ns.max(until(asked_ns, ttl_ns));
        self.renew_ns = now_ns + ttl_ns.min(MAX_TTL_NS) / RENEWALS;
    }

    /// Gives up the lead and the lease.
    fn ends(&mut self) {
        (self.term, self.lease, self.free_since_ns) = (None, None, None);
        self.resigns = !self.is_able;
        self.look_ns = 0;
    }
}

/// Lower bound of the end of a lease that the store was asked at `asked_ns` to grant or renew.
fn until(asked_ns: u64, ttl_ns: u64) -> u64 {
    let apart_ns = ttl_ns / DRIFT_DIVISOR + DRIFT_MARGIN_NS;
    asked_ns.saturating_add(ttl_ns.saturating_sub(apart_ns).min(MAX_TTL_NS))
}

#[cfg(test)]
mod store;
#[cfg(test)]
mod tests;
