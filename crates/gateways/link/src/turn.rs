//! This host's turn to serve its shard: what the threads of the link know of it, and the permit of the worker.

use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_bus::clock;
use joulebus_standby::{Permit, PermitError, Places};

/// What it is at an instant; shared by the threads.
#[derive(Debug)]
pub(crate) struct Turn {
    places: Places,
    /// 0: another serves, or nobody.
    term: AtomicU64,
    /// As [`Permit::until_ns`].
    until_ns: AtomicU64,
    /// Greatest term in which anybody was heard to serve, or this host has.
    heard: AtomicU64,
    /// When the worker of this host was last seen to do what it is to do, monotonic ns.
    able_ns: AtomicU64,
}

impl Turn {
    /// Goes on with the permit that a link before has left.
    ///
    /// # Errors
    /// [`PermitError`].
    pub(crate) fn resume(places: Places) -> Result<(Self, Option<Permit>), PermitError> {
        let now_ns = clock::monotonic_ns();
        let boot_ns = clock::boot_ns();
        let permit = Permit::read(&places.permit)?.filter(|permit| permit.holds(boot_ns));
        let turn = Self {
            places,
            term: AtomicU64::new(0),
            until_ns: AtomicU64::new(0),
            heard: AtomicU64::new(0),
            able_ns: AtomicU64::new(now_ns),
        };
        if let Some(permit) = &permit {
            turn.begin(permit);
        }
        Ok((turn, permit))
    }

    pub(crate) const fn places(&self) -> &Places {
        &self.places
    }

    /// Term in which this host's worker serves now; 0 if it does not.
    pub(crate) fn term(&self) -> u64 {
        // The term last: with it the time until which it holds.
        let term = self.term.load(Ordering::Acquire);
        let until_ns = self.until_ns.load(Ordering::Acquire);
        if until_ns == u64::MAX || clock::boot_ns() < until_ns {
            term
        } else {
            0
        }
    }

    /// Permits the worker of this host to serve, or to go on.
    ///
    /// # Errors
    /// [`PermitError`]: it is not permitted.
    pub(crate) fn grant(&self, permit: &Permit) -> Result<(), PermitError> {
        permit.write(&self.places.permit)?;
        self.begin(permit);
        Ok(())
    }

    fn begin(&self, permit: &Permit) {
        self.hear(permit.term);
        if self.term.load(Ordering::Acquire) != permit.term {
            self.term.store(0, Ordering::Release);
            // It has to restore a state first.
            self.worker_works();
        }
        let until_ns = permit.until_ns.unwrap_or(u64::MAX);
        self.until_ns.store(until_ns, Ordering::Release);
        self.term.store(permit.term, Ordering::Release);
    }

    /// Ends the worker's permit.
    ///
    /// # Errors
    /// [`PermitError`]: it ends when its time is over.
    pub(crate) fn withdraw(&self) -> Result<(), PermitError> {
        self.term.store(0, Ordering::Release);
        Permit::withdraw(&self.places.permit)
    }

    /// The worker of this host sends, or has just been permitted to.
    pub(crate) fn worker_works(&self) {
        self.able_ns.store(clock::monotonic_ns(), Ordering::Release);
    }

    /// Time since the worker of this host was seen to work, ns.
    pub(crate) fn idle_ns(&self) -> u64 {
        let able_ns = self.able_ns.load(Ordering::Acquire);
        clock::monotonic_ns().saturating_sub(able_ns)
    }

    /// Somebody serves, or has served, in this term.
    pub(crate) fn hear(&self, term: u64) {
        self.heard.fetch_max(term, Ordering::AcqRel);
    }

    pub(crate) fn heard(&self) -> u64 {
        self.heard.load(Ordering::Acquire)
    }
}
