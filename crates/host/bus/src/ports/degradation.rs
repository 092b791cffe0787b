//! Failed connections to other ports (#129).

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use iceoryx2::port::{DegradationAction, DegradationCause, DegradationInfo};

/// Maximum number of ports remembered at a time.
const MAX_PORTS: usize = 64;

/// Connections of a port that failed: their number, and the ports of the other side.
#[derive(Debug)]
pub(crate) struct Failures {
    count: AtomicU64,
    ports: Mutex<Vec<u128>>,
}

impl Failures {
    pub(crate) fn new() -> Arc<Self> {
        Arc::new(Self {
            count: AtomicU64::new(0),
            ports: Mutex::new(Vec::with_capacity(MAX_PORTS)),
        })
    }

    /// A handler that records a failed connection to `port`. Returning an error immediately would
    /// leave the following ports unconnected too.
    pub(crate) fn handler(
        self: &Arc<Self>,
        port: fn(&DegradationInfo) -> u128,
    ) -> impl Fn(DegradationCause, &DegradationInfo) -> DegradationAction + Send + 'static {
        let failures = Arc::clone(self);
        move |_, info| {
            failures.add(port(info));
            DegradationAction::Ignore
        }
    }

    fn add(&self, port: u128) {
        let mut ports = self.ports.lock().unwrap_or_else(PoisonError::into_inner);
        if !ports.contains(&port) && ports.len() < MAX_PORTS {
            ports.push(port);
        }
        self.count.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of failures so far.
    pub(crate) fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Forgets the ports that `list` does not name. True if any are left.
    pub(crate) fn are_listed(&self, list: impl FnOnce(&mut dyn FnMut(u128))) -> bool {
        let mut ports = self.ports.lock().unwrap_or_else(PoisonError::into_inner);
        let mut left = 0;
        list(&mut |listed| {
            if let Some(at) = ports[left..].iter().position(|port| *port == listed) {
                ports.swap(left, left + at);
                left += 1;
            }
        });
        ports.truncate(left);
        left > 0
    }

    /// Forgets all ports: they are connected.
    pub(crate) fn forget(&self) {
        self.ports.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_connection_is_remembered_until_its_port_is_gone_or_it_is_forgotten() {
        let failures = Failures::new();
        let among =
            |listed: &[u128]| failures.are_listed(|each| listed.iter().copied().for_each(each));
        assert!(!among(&[7, 8]));
        for port in [5, 7, 7, 9] {
            failures.add(port);
        }
        assert_eq!(failures.count(), 4);
        assert!(among(&[9, 8, 7]));
        assert!(among(&[7, 6, 5]), "7 is left");
        assert!(!among(&[9, 5]), "they are gone, and may not return");
        failures.add(9);
        failures.forget();
        assert!(!among(&[9]));
    }

    #[test]
    fn more_failed_connections_than_are_remembered_are_counted() {
        let failures = Failures::new();
        (0..1_000).for_each(|port| failures.add(port));
        assert_eq!(failures.count(), 1_000);
        assert_eq!(failures.ports.lock().unwrap().capacity(), MAX_PORTS);
    }
}
