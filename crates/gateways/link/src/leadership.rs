//! The leadership of this host's worker: shared by the threads of a link, and written to the
//! worker's permit.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use joulebus_bus::clock;
use joulebus_connect::standby::{Permit, PermitError, StandbyFiles};

/// Leadership of this host's worker, with the term. Shared by the threads.
#[derive(Debug)]
pub(crate) struct Leadership {
    places: StandbyFiles,
    /// Term in which this host leads. 0 if another or no candidate does.
    term: AtomicU64,
    /// As [`Permit::until_ns`].
    until_ns: AtomicU64,
    /// Highest term in which any candidate is known to have led, this one included.
    highest_term: AtomicU64,
    /// When this host's worker last sent as leader, started or was permitted to lead, monotonic ns.
    active_ns: AtomicU64,
    /// It has sent since.
    has_sent: AtomicBool,
}

impl Leadership {
    /// Continues with the permit of the previous link on this host, if it still holds.
    pub(crate) fn resume(places: StandbyFiles) -> Result<(Self, Option<Permit>), PermitError> {
        let now_ns = clock::monotonic_ns();
        let boot_ns = clock::boot_ns();
        let permit = Permit::read(&places.permit)?.filter(|permit| permit.holds(boot_ns));
        let leadership = Self {
            places,
            term: AtomicU64::new(0),
            until_ns: AtomicU64::new(0),
            highest_term: AtomicU64::new(0),
            active_ns: AtomicU64::new(now_ns),
            has_sent: AtomicBool::new(false),
        };
        if let Some(permit) = &permit {
            leadership.begin(permit);
        }
        Ok((leadership, permit))
    }

    pub(crate) const fn places(&self) -> &StandbyFiles {
        &self.places
    }

    /// Term in which this host's worker leads now. 0 if it does not.
    pub(crate) fn term(&self) -> u64 {
        // `begin` stores the term last. A term that is read here therefore comes with its own end
        // or a later one.
        let term = self.term.load(Ordering::Acquire);
        let until_ns = self.until_ns.load(Ordering::Acquire);
        if clock::boot_ns() < until_ns { term } else { 0 }
    }

    /// Permits the worker of this host to lead, or to go on.
    pub(crate) fn grant(&self, permit: &Permit) -> Result<(), PermitError> {
        permit.write(&self.places.permit)?;
        self.begin(permit);
        Ok(())
    }

    fn begin(&self, permit: &Permit) {
        self.observe_term(permit.term);
        if self.term.load(Ordering::Acquire) != permit.term {
            self.term.store(0, Ordering::Release);
            self.worker_starts();
        }
        self.until_ns.store(permit.until_ns, Ordering::Release);
        self.term.store(permit.term, Ordering::Release);
    }

    /// Ends the worker's permit, and leaves it as ended. The worker ends then, and the next one
    /// removes the permit. If it stays, the worker hangs: this outlives the term and this link.
    ///
    /// # Errors
    /// [`PermitError`]: the permit stays until its time is over.
    pub(crate) fn end(&self, term: u64) -> Result<(), PermitError> {
        self.term.store(0, Ordering::Release);
        Permit { term, until_ns: 0, lease: 0 }.write(&self.places.permit)
    }

    /// True if the worker has a permit that is over.
    pub(crate) fn has_ended_permit(&self) -> bool {
        let permit = Permit::read(&self.places.permit).ok().flatten();
        permit.is_some_and(|permit| !permit.holds(clock::boot_ns()))
    }

    /// Notes that this host's worker is another process, or has just been permitted to lead. It
    /// needs time to restore a state.
    pub(crate) fn worker_starts(&self) {
        self.has_sent.store(false, Ordering::Release);
        self.active_ns.store(clock::monotonic_ns(), Ordering::Release);
    }

    /// Notes that this host's worker has sent.
    pub(crate) fn worker_sends(&self) {
        self.active_ns.store(clock::monotonic_ns(), Ordering::Release);
        self.has_sent.store(true, Ordering::Release);
    }

    /// True if this host's worker has sent since it started.
    pub(crate) fn has_sent(&self) -> bool {
        self.has_sent.load(Ordering::Acquire)
    }

    /// Time since this host's worker last sent or started, ns.
    pub(crate) fn idle_ns(&self) -> u64 {
        let active_ns = self.active_ns.load(Ordering::Acquire);
        clock::monotonic_ns().saturating_sub(active_ns)
    }

    /// Notes a term in which a candidate leads or has led.
    pub(crate) fn observe_term(&self, term: u64) {
        self.highest_term.fetch_max(term, Ordering::AcqRel);
    }

    pub(crate) fn highest_term(&self) -> u64 {
        self.highest_term.load(Ordering::Acquire)
    }
}
