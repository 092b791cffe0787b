//! Who of a shard's candidates serves, by a lease in a store that all of them reach: what to ask of the store next, and what
//! follows from its answers. Time comes in as an argument.
//!
//! The store has, for each shard, the *holder*, which disappears with its lease; the *term*, which stays and grows; and the
//! *wish*, the candidate that an operator wants. A candidate holds the shard where the holder has its lease. The store ends
//! a lease when its time to live has passed since it took the last renewal. That was after this host sent it; so this host
//! counts from there, less what two clocks may run apart, and is silent before the store gives the shard to another. It
//! needs no answer for that, and no time of another host.
//!
//! The term is one more than the store's, and than any that this host has heard of: so it is greater than all before
//! even where the store has forgotten, or somebody has served without it.

/// Share of a time to live by which two clocks may run apart: each 500 ppm by slewing and 100 ppm by its crystal, four times
/// over; and what remains for the rounding of times.
const APART_DIVISOR: u64 = 200;
const APART_NS: u64 = 10_000_000;
/// Renewals in a time to live: one or two may be lost.
const RENEWALS: u64 = 5;
/// Looks at a shard of another in a time to live, and the shortest and longest time between two.
const LOOKS: u64 = 10;
const LOOK_EVERY_NS: (u64, u64) = (100_000_000, 500_000_000);
/// Longest time to live of a lease, s: no longer one is asked for, and none is taken to last longer, whatever the store says.
pub(crate) const MOST_TTL_S: u32 = 60;
const LONGEST_NS: u64 = MOST_TTL_S as u64 * 1_000_000_000;
/// How much longer a candidate waits with a free shard than the one before it in the list.
const RANK_NS: u64 = 300_000_000;
/// How long the others leave a free shard to the candidate that an operator wants, at most: it looks more often.
const WISHED_NS: u64 = 1_500_000_000;

/// What the store has of a shard.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Seen {
    pub(crate) holder: Option<Holder>,
    /// The last term; 0 before the first.
    pub(crate) term: u64,
    /// The store's revision of the term, 0 if there is none: it has changed if that has.
    pub(crate) term_revision: u64,
    /// The candidate that is to serve, if an operator wishes one.
    pub(crate) wish: Option<String>,
}

/// Who holds a shard.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Holder {
    pub(crate) name: String,
    pub(crate) term: u64,
    pub(crate) lease: u64,
}

/// What to ask the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Call {
    /// A new lease.
    Grant,
    /// What it has of the shard.
    Look,
    /// Makes this candidate the holder and the term known, if there is no holder and the term is of that revision; and
    /// removes the wish.
    Acquire {
        lease: u64,
        term: u64,
        term_revision: u64,
    },
    /// Renews the lease.
    Renew { lease: u64 },
}

/// What the store has answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Reply {
    Granted {
        lease: u64,
        ttl_ns: u64,
    },
    Seen(Seen),
    /// Whether the shard was acquired.
    Acquired(bool),
    /// 0: there is no such lease any more.
    Renewed {
        ttl_ns: u64,
    },
    /// Nothing that can be understood, or in time. Whether the store has done it is not known.
    Failed,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Next {
    Call(Call),
    /// Nothing before this instant.
    Wait(u64),
}

/// The right to serve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Right {
    pub(crate) term: u64,
    /// From then on another may have it, ns since boot with suspend.
    pub(crate) until_ns: u64,
    pub(crate) lease: u64,
}

/// A lease, and until when it certainly lasts.
#[derive(Debug, Clone, Copy)]
struct Own {
    id: u64,
    until_ns: u64,
}

/// One candidate.
#[derive(Debug)]
pub(crate) struct Candidate {
    name: String,
    /// Place in the list of candidates: the first takes a free shard first.
    rank: u64,
    ttl_ns: u64,
    lease: Option<Own>,
    /// Term of the shard, while it is held.
    term: Option<u64>,
    /// It is to be given up: not renewed, and left to its end.
    resigns: bool,
    /// The worker of this host can serve.
    is_able: bool,
    /// Greatest term that anybody was heard to serve in.
    heard: u64,
    /// Since when the shard is free, as far as this candidate has seen.
    free_since_ns: Option<u64>,
    seen: Seen,
    look_ns: u64,
    renew_ns: u64,
}

impl Candidate {
    /// `right`: of a link that has started again, and goes on with it.
    pub(crate) fn new(name: &str, rank: usize, ttl_ns: u64, right: Option<Right>) -> Self {
        Self {
            name: name.to_owned(),
            rank: rank as u64,
            ttl_ns,
            lease: right.map(|right| Own {
                id: right.lease,
                until_ns: right.until_ns,
            }),
            term: right.map(|right| right.term),
            resigns: false,
            is_able: true,
            heard: 0,
            free_since_ns: None,
            seen: Seen::default(),
            look_ns: 0,
            renew_ns: 0,
        }
    }

    /// The right to serve at `now_ns`.
    pub(crate) fn right(&self, now_ns: u64) -> Option<Right> {
        let (own, term) = (self.lease?, self.term?);
        (now_ns < own.until_ns && term >= self.heard).then_some(Right {
            term,
            until_ns: own.until_ns,
            lease: own.id,
        })
    }

    /// Somebody was heard to serve in this term.
    pub(crate) fn hears(&mut self, term: u64) {
        self.heard = self.heard.max(term);
    }

    /// Whether the worker of this host can serve: one that cannot takes no shard, and gives up the one that it has.
    pub(crate) fn is_able(&mut self, is_able: bool) {
        self.is_able = is_able;
        self.resigns |= !is_able;
    }

    /// The candidate that holds the shard, as seen last.
    pub(crate) fn holder(&self) -> Option<&Holder> {
        self.seen.holder.as_ref()
    }

    /// What to do at `now_ns`.
    pub(crate) fn next(&mut self, now_ns: u64) -> Next {
        if self.is_over(now_ns) {
            self.ends();
        }
        if self.term.is_some() {
            return self.next_of_holder(now_ns);
        }
        if now_ns < self.look_ns {
            return Next::Wait(self.look_ns);
        }
        // After the last number no term is greater: better nobody serves than two in one term.
        if self.is_turn(now_ns)
            && let Some(term) = self.seen.term.max(self.heard).checked_add(1)
        {
            return match self.lease.filter(|own| now_ns < own.until_ns) {
                Some(own) => Next::Call(Call::Acquire {
                    lease: own.id,
                    term,
                    term_revision: self.seen.term_revision,
                }),
                None => Next::Call(Call::Grant),
            };
        }
        Next::Call(Call::Look)
    }

    /// Whether it is too late for what is held, or another serves in a later term: whatever the store says, it begins anew.
    fn is_over(&self, now_ns: u64) -> bool {
        self.term.is_some() && self.right(now_ns).is_none()
    }

    fn next_of_holder(&self, now_ns: u64) -> Next {
        let renews = (!self.resigns).then_some(self.renew_ns);
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

    /// Whether the shard is free, and it is this candidate's turn to take it.
    fn is_turn(&self, now_ns: u64) -> bool {
        let Some(since_ns) = self.free_since_ns.filter(|_| self.is_able) else {
            return false;
        };
        let free_ns = now_ns.saturating_sub(since_ns);
        match self.seen.wish.as_deref() {
            Some(wish) if wish == self.name => true,
            // It may be gone: then the others take it.
            Some(_) => free_ns >= self.ttl_ns.min(WISHED_NS) + self.rank * RANK_NS,
            None => free_ns >= self.rank * RANK_NS,
        }
    }

    /// Takes the answer to a call that was made at `asked_ns` and answered, or given up, at `now_ns`.
    pub(crate) fn answered(&mut self, call: &Call, reply: Reply, (asked_ns, now_ns): (u64, u64)) {
        match (call, reply) {
            // 0 is no lease: what is put with it stays for ever. One that is over by now is asked for again, but not at once.
            (Call::Grant, Reply::Granted { lease, ttl_ns })
                if lease > 0 && until(asked_ns, ttl_ns) > now_ns =>
            {
                self.lease = Some(Own {
                    id: lease,
                    until_ns: until(asked_ns, ttl_ns),
                });
            }
            (Call::Look, Reply::Seen(seen)) => self.sees(seen, now_ns),
            (Call::Acquire { term, .. }, Reply::Acquired(true)) => {
                self.term = Some(*term);
                self.resigns = !self.is_able;
                self.free_since_ns = None;
                self.renew_ns = now_ns;
            }
            (Call::Acquire { .. }, Reply::Acquired(false)) => {
                // Another was faster.
                self.free_since_ns = None;
                self.look_ns = now_ns;
            }
            (Call::Renew { lease }, Reply::Renewed { ttl_ns }) => {
                self.renewed(*lease, ttl_ns, (asked_ns, now_ns));
            }
            // Asked again soon; of an acquisition the next look tells what it did.
            (call, _) => {
                let soon_ns = now_ns + LOOK_EVERY_NS.0;
                match call {
                    Call::Renew { .. } => self.renew_ns = soon_ns,
                    _ => self.look_ns = soon_ns,
                }
                if matches!(call, Call::Acquire { .. }) {
                    self.free_since_ns = None;
                }
            }
        }
    }

    fn sees(&mut self, seen: Seen, now_ns: u64) {
        let (least_ns, most_ns) = LOOK_EVERY_NS;
        self.look_ns = now_ns + (self.ttl_ns / LOOKS).clamp(least_ns, most_ns);
        let own = self.lease.map(|own| own.id);
        let held = seen.holder.as_ref();
        match held.filter(|holder| Some(holder.lease) == own && holder.name == self.name) {
            Some(holder) => {
                if self.term != Some(holder.term) {
                    // The answer to the acquisition was lost.
                    self.term = Some(holder.term);
                    self.resigns = !self.is_able;
                    self.renew_ns = now_ns;
                }
                let wish = seen.wish.as_deref();
                self.resigns |= wish.is_some_and(|wish| wish != self.name);
                self.free_since_ns = None;
            }
            None => {
                // Also where the holder was removed by hand.
                self.term = None;
                self.free_since_ns = match held {
                    None => Some(self.free_since_ns.unwrap_or(now_ns)),
                    Some(_) => None,
                };
            }
        }
        self.seen = seen;
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
        self.renew_ns = now_ns + ttl_ns.min(LONGEST_NS) / RENEWALS;
    }

    /// The shard is no longer this candidate's, nor will it be by this lease.
    fn ends(&mut self) {
        (self.term, self.lease, self.free_since_ns) = (None, None, None);
        self.resigns = !self.is_able;
        self.look_ns = 0;
    }
}

/// Until when a lease certainly lasts that the store was asked at `asked_ns` to grant or renew.
fn until(asked_ns: u64, ttl_ns: u64) -> u64 {
    let apart_ns = ttl_ns / APART_DIVISOR + APART_NS;
    asked_ns.saturating_add(ttl_ns.saturating_sub(apart_ns).min(LONGEST_NS))
}

#[cfg(test)]
mod tests;
