//! What other threads send by.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rumqttc::{AsyncClient, QoS};

/// Hands messages to the connection; never waits.
#[derive(Debug)]
pub(crate) struct Outlet {
    client: AsyncClient,
    up: AtomicBool,
    connections: AtomicU64,
    sent: AtomicU64,
    lost: AtomicU64,
}

impl Outlet {
    pub(super) fn new(client: AsyncClient) -> Self {
        Self {
            client,
            up: AtomicBool::new(false),
            connections: AtomicU64::new(0),
            sent: AtomicU64::new(0),
            lost: AtomicU64::new(0),
        }
    }

    pub(super) fn connected(&self) {
        self.connections.fetch_add(1, Ordering::Relaxed);
        self.up.store(true, Ordering::Relaxed);
    }

    /// True if it ever was connected.
    pub(super) fn disconnected(&self) -> bool {
        self.up.store(false, Ordering::Relaxed);
        self.connections() > 0
    }

    pub(crate) fn is_connected(&self) -> bool {
        self.up.load(Ordering::Relaxed)
    }

    /// How often a broker has accepted the connection: after another time it may have forgotten what it kept.
    pub(crate) fn connections(&self) -> u64 {
        self.connections.load(Ordering::Relaxed)
    }

    /// Hands over a message; false if there is no connection, or its queue is full. What is then not told later is lost: see
    /// [`Outlet::count_lost`].
    pub(crate) fn write(&self, topic: String, payload: Vec<u8>, qos: QoS, retain: bool) -> bool {
        if !self.is_connected() {
            return false;
        }
        let is_sent = self.client.try_publish(topic, qos, retain, payload).is_ok();
        self.sent.fetch_add(u64::from(is_sent), Ordering::Relaxed);
        is_sent
    }

    /// Counts a message that is not tried again.
    pub(crate) fn count_lost(&self) {
        self.lost.fetch_add(1, Ordering::Relaxed);
    }

    /// Messages handed over.
    pub(crate) fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Messages that did not fit and were not tried again.
    pub(crate) fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}
