//! Watches one process.

use joulebus_simulated_host as host;

/// Detects the end of a process.
#[derive(Debug)]
pub struct PeerWatch {
    pid: u32,
    life: u64,
}

impl PeerWatch {
    /// Watches the process `pid`; `None` if there is no such process.
    pub fn open(pid: u32) -> Option<Self> {
        host::operation();
        let life = host::life(pid)?;
        Some(Self { pid, life })
    }

    /// True if the process has ended.
    pub fn is_gone(&self) -> bool {
        host::life(self.pid) != Some(self.life)
    }
}
