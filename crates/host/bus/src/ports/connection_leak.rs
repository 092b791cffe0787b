//! Decides when the port for questions must be reopened, before connections of clients that left
//! fill it. This is not the defect of #1797.

/// Clients that may leave before the port is reopened: far below the 128 that iceoryx2 allows.
const MAX_LEFT: usize = 16;
/// Time after a client has left until its connection counts as leaked, ns.
const LEAKED_AFTER_NS: u64 = 1_000_000_000;

/// The clients of a port.
#[derive(Debug, Default)]
pub(crate) struct ConnectionLeak {
    /// Ports of the clients at the last look.
    clients: Vec<u128>,
    /// Clients that have left since the port was opened.
    left: usize,
    /// When the last one did, monotonic ns.
    left_ns: u64,
}

impl ConnectionLeak {
    /// Takes the ports of all clients, at `now_ns`. Returns their number.
    pub(crate) fn look(&mut self, now: Vec<u128>, now_ns: u64) -> usize {
        let before = std::mem::replace(&mut self.clients, now);
        let left = before.iter().filter(|port| !self.clients.contains(port));
        let left = left.count();
        if left > 0 {
            self.left += left;
            self.left_ns = now_ns;
        }
        self.clients.len()
    }

    /// True if connections of clients that have left may be kept. `is_idle`: no question waits.
    pub(crate) fn needs_reopen(&self, is_idle: bool, now_ns: u64) -> bool {
        let is_quiet = now_ns.saturating_sub(self.left_ns) >= LEAKED_AFTER_NS;
        self.left >= MAX_LEFT || (self.left > 0 && is_idle && is_quiet)
    }
}
