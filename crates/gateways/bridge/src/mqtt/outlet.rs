//! The queue of messages for the broker, filled by other threads.

use std::collections::VecDeque;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use mqtt5_protocol::QoS;
use rustix::event::{EventfdFlags, eventfd};

/// A message for the broker.
#[derive(Debug, Clone)]
pub(crate) struct Outgoing {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) qos: QoS,
    pub(crate) retain: bool,
    /// Seconds after which the broker gives it to nobody. Brokers of MQTT 3.1.1 do not know it.
    pub(crate) expires_s: Option<u32>,
}

/// Hands messages to the connection, without blocking.
#[derive(Debug)]
pub(crate) struct Outlet {
    queue: Mutex<VecDeque<Outgoing>>,
    capacity: usize,
    wake: OwnedFd,
    up: AtomicBool,
    connections: AtomicU64,
    sent: AtomicU64,
    lost: AtomicU64,
}

impl Outlet {
    /// An empty queue of up to `capacity` messages.
    pub(super) fn new(capacity: usize) -> io::Result<Self> {
        Ok(Self {
            queue: Mutex::default(),
            capacity,
            wake: eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC)?,
            up: AtomicBool::new(false),
            connections: AtomicU64::new(0),
            sent: AtomicU64::new(0),
            lost: AtomicU64::new(0),
        })
    }

    fn queue(&self) -> MutexGuard<'_, VecDeque<Outgoing>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a new connection. What waited for an earlier one is dropped.
    pub(super) fn connected(&self) {
        self.queue().clear();
        self.connections.fetch_add(1, Ordering::Relaxed);
        self.up.store(true, Ordering::Relaxed);
    }

    /// Notes the loss of the connection. Returns whether there ever was one.
    pub(super) fn disconnected(&self) -> bool {
        self.up.store(false, Ordering::Relaxed);
        self.connections() > 0
    }

    pub(crate) fn is_connected(&self) -> bool {
        self.up.load(Ordering::Relaxed)
    }

    /// Number of connections that a broker has accepted. After each of them the broker may have
    /// lost what it retained.
    pub(crate) fn connections(&self) -> u64 {
        self.connections.load(Ordering::Relaxed)
    }

    /// Hands over a message. Returns false if there is no connection or its queue is full. A
    /// message that is not retried is lost: see [`Outlet::count_lost`].
    pub(crate) fn write(&self, message: Outgoing) -> bool {
        let mut queue = self.queue();
        if !self.is_connected() || queue.len() >= self.capacity {
            return false;
        }
        queue.push_back(message);
        drop(queue);
        // It fails only where the counter is full, which wakes as well.
        let _ = rustix::io::write(&self.wake, &1_u64.to_ne_bytes());
        self.sent.fetch_add(1, Ordering::Relaxed);
        true
    }

    /// The next message, for the connection.
    pub(super) fn take(&self) -> Option<Outgoing> {
        self.queue().pop_front()
    }

    /// Readable while messages wait that were not there at the last [`Outlet::woken`].
    pub(super) const fn wake(&self) -> &OwnedFd {
        &self.wake
    }

    pub(super) fn woken(&self) {
        let _ = rustix::io::read(&self.wake, &mut [0_u8; 8]);
    }

    /// Counts a message that is not retried.
    pub(crate) fn count_lost(&self) {
        self.lost.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of messages handed over.
    pub(crate) fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Number of messages that were not accepted and not retried.
    pub(crate) fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}
