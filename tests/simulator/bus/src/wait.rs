//! Events.

use std::cell::Cell;
use std::io;
use std::rc::Rc;

use joulebus_simulated_host::{self as host, time};
use joulebus_wire::{Service, WakeEvent};

use crate::liveness::worker_lock::LockWatch;
use crate::ports::OpenPlaces;
use crate::queues::{Waiting, with};
use crate::{Bus, Limits, OpenError, PeerWatch, WaitError, Woken};

/// The limit of the real waiter.
const MAX_SLEEP_NS: u64 = 100_000_000;

/// Sends a service's event.
#[derive(Debug)]
pub struct Waker {
    service: Service,
    bus: Bus,
}

impl Waker {
    pub(crate) fn open(
        bus: &Bus,
        service: Service,
        _: &Limits,
        _: (usize, usize),
    ) -> Result<Self, OpenError> {
        host::operation();
        crate::left::check_left()?;
        bus.check()?;
        let bus = bus.clone();
        Ok(Self { service, bus })
    }

    /// Wakes all waiters; returns their number.
    pub fn wake(&self, event: WakeEvent) -> Result<usize, WaitError> {
        host::operation();
        self.bus.check()?;
        if host::is_dead() {
            return Ok(0);
        }
        Ok(with(self.service, |state| {
            for waiting in &state.waiting {
                waiting.wake(event);
            }
            state.waiting.len()
        }))
    }

    /// Wakes the waiter of this id, if there is one.
    pub(crate) fn wake_one(&self, waiter: u128, event: WakeEvent) -> Result<(), WaitError> {
        host::operation();
        self.bus.check()?;
        if !host::is_dead() {
            with(self.service, |state| {
                let of_id = |waiting: &&Rc<Waiting>| u128::from(waiting.number) == waiter;
                if let Some(waiting) = state.waiting.iter().find(of_id) {
                    waiting.wake(event);
                }
            });
        }
        Ok(())
    }
}

impl Waiting {
    fn wake(&self, event: WakeEvent) {
        let mut woken = self.woken.get();
        match event {
            WakeEvent::Frame => woken.frame = true,
            WakeEvent::Died => woken.died = true,
            WakeEvent::Ended => woken.ended = true,
            WakeEvent::Unreachable => woken.unreachable = true,
        }
        self.woken.set(woken);
        host::wake(self.pid, self.thread);
    }
}

/// Waits for a service's events: informs the host until when, and returns at once.
#[derive(Debug)]
pub struct Waiter {
    waiting: Rc<Waiting>,
    service: Service,
    bus: Bus,
}

impl Waiter {
    pub(crate) fn open(
        bus: &Bus,
        service: Service,
        _: &Limits,
        _: (usize, usize),
        _: Option<OpenPlaces>,
    ) -> Result<Self, OpenError> {
        host::operation();
        crate::left::check_left()?;
        bus.check()?;
        let waiting = Rc::new(Waiting {
            number: host::number(),
            pid: bus.pid,
            thread: host::thread(),
            woken: Cell::default(),
        });
        with(service, |state| state.waiting.push(Rc::clone(&waiting)));
        Ok(Self { waiting, service, bus: bus.clone() })
    }

    /// The id by which it can be woken alone.
    pub(crate) fn id(&self) -> u128 {
        u128::from(self.waiting.number)
    }

    /// Returns what has happened. If nothing has, the process sleeps from its next pause on until
    /// `deadline_ns`.
    pub fn wait_until(
        &mut self,
        deadline_ns: Option<u64>,
        peer: Option<&PeerWatch>,
    ) -> Result<Woken, WaitError> {
        host::operation();
        self.bus.check()?;
        let mut woken = self.waiting.woken.take();
        woken.peer_gone = peer.is_some_and(PeerWatch::is_gone);
        let now_ns = time::monotonic_ns();
        let longest_ns = now_ns.saturating_add(MAX_SLEEP_NS);
        let until_ns = if woken.is_nothing() {
            deadline_ns.map_or(longest_ns, |deadline_ns| deadline_ns.min(longest_ns))
        } else {
            now_ns
        };
        host::sleep_until(until_ns);
        // A thread's round must end: it sleeps after it.
        woken.interrupted = host::thread() != 0 && woken.is_nothing() && until_ns > now_ns;
        Ok(woken)
    }
}

impl Drop for Waiter {
    fn drop(&mut self) {
        let number = self.waiting.number;
        with(self.service, |state| {
            state.waiting.retain(|waiting| waiting.number != number);
        });
    }
}

/// Waits for times, and for the end of the worker: as the waiter, it returns at once.
#[derive(Debug)]
pub struct Poller {
    lock: Option<LockWatch>,
    bus: Bus,
}

impl Poller {
    pub(crate) fn new(bus: &Bus) -> Self {
        let bus = bus.clone();
        Self { lock: None, bus }
    }

    /// From now on, process `pid` is the worker whose end is waited for.
    pub fn watch_worker(&mut self, pid: u32) {
        host::operation();
        self.lock = LockWatch::open(pid);
    }

    /// Returns what has happened. If nothing has, the process sleeps from its next pause on until
    /// `deadline_ns`.
    pub fn wait_until(
        &mut self,
        deadline_ns: u64,
        peer: Option<&PeerWatch>,
    ) -> Result<Woken, WaitError> {
        host::operation();
        self.bus.check()?;
        let ended = self.lock.as_ref().is_some_and(LockWatch::has_ended);
        let mut woken = Woken::default();
        (woken.ended, woken.peer_gone) = (ended, peer.is_some_and(PeerWatch::is_gone));
        let now_ns = time::monotonic_ns();
        let until_ns = if woken.is_nothing() {
            deadline_ns.min(now_ns.saturating_add(MAX_SLEEP_NS))
        } else {
            self.lock = None;
            now_ns
        };
        host::sleep_until(until_ns);
        woken.interrupted = host::thread() != 0 && woken.is_nothing() && until_ns > now_ns;
        Ok(woken)
    }
}

/// The simulated host has no descriptors.
#[derive(Debug, Clone)]
pub struct Readiness {}

impl Readiness {
    /// Same as in `joulebus-bus`.
    pub fn new() -> io::Result<Self> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Same as in `joulebus-bus`.
    pub fn of(_waiter: &Waiter) -> io::Result<Self> {
        Self::new()
    }

    /// Same as in `joulebus-bus`.
    pub const fn watch(&self, _peer: &PeerWatch) -> io::Result<()> {
        Ok(())
    }
}
