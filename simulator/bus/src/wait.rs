//! Events.

use std::cell::Cell;
use std::rc::Rc;

use joulebus_simulated_host::{self as host, time};
use joulebus_wire::{Service, WakeEvent};

use crate::queues::{Waiting, with};
use crate::{Bus, OpenError, PeerWatch, WaitError, Woken};

/// As of the real waiter.
const LONGEST_SLEEP_NS: u64 = 100_000_000;

/// Sends a service's event.
#[derive(Debug)]
pub struct Waker {
    service: Service,
    bus: Bus,
}

impl Waker {
    pub(crate) fn open(bus: &Bus, service: Service) -> Result<Self, OpenError> {
        host::operation();
        crate::bus::check_left()?;
        bus.check()?;
        let bus = bus.clone();
        Ok(Self { service, bus })
    }

    /// Wakes all waiters; returns their number.
    ///
    /// # Errors
    /// The files of this process were removed.
    pub fn wake(&self, event: WakeEvent) -> Result<usize, WaitError> {
        host::operation();
        self.bus.check()?;
        if host::is_dead() {
            return Ok(0);
        }
        Ok(with(self.service, |state| {
            for waiting in &state.waiting {
                let mut woken = waiting.woken.get();
                match event {
                    WakeEvent::Frame => woken.frame = true,
                    WakeEvent::Died => woken.died = true,
                    WakeEvent::Ended => woken.ended = true,
                }
                waiting.woken.set(woken);
                host::wake(waiting.pid);
            }
            state.waiting.len()
        }))
    }
}

/// Waits for a service's events: tells the host until when, and returns at once.
#[derive(Debug)]
pub struct Waiter {
    waiting: Rc<Waiting>,
    service: Service,
    bus: Bus,
}

impl Waiter {
    pub(crate) fn open(bus: &Bus, service: Service) -> Result<Self, OpenError> {
        host::operation();
        crate::bus::check_left()?;
        bus.check()?;
        let waiting = Rc::new(Waiting {
            number: host::number(),
            pid: bus.pid,
            woken: Cell::default(),
        });
        with(service, |state| state.waiting.push(Rc::clone(&waiting)));
        Ok(Self {
            waiting,
            service,
            bus: bus.clone(),
        })
    }

    /// Returns what has happened. If nothing has, the process sleeps from its next pause on until
    /// `deadline_ns`.
    ///
    /// # Errors
    /// The files of this process were removed.
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
        let longest_ns = now_ns.saturating_add(LONGEST_SLEEP_NS);
        let until_ns = if woken.is_nothing() {
            deadline_ns.map_or(longest_ns, |deadline_ns| deadline_ns.min(longest_ns))
        } else {
            now_ns
        };
        host::sleep_until(until_ns);
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
