//! The sending end of the broker's connection, for other threads.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rumqttc::{AsyncClient, QoS};

/// Hands messages to the connection. Never blocks.
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

    /// Notes the loss of the connection. Returns whether there was one.
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
    pub(crate) fn write(&self, topic: String, payload: Vec<u8>, qos: QoS, retain: bool) -> bool {
        if !self.is_connected() {
            return false;
        }
        let is_sent = self.client.try_publish(topic, qos, retain, payload).is_ok();
        self.sent.fetch_add(u64::from(is_sent), Ordering::Relaxed);
        is_sent
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
