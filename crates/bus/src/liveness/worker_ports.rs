//! Filter for frames on the worker's services: only those of the process that holds the worker's
//! lock are accepted.
//!
//! Every process of the user can send there. A frame of another process would otherwise be taken
//! for the worker's, and one with a run or a tick far in the future would hide all frames of the
//! worker.

use std::path::PathBuf;

use crate::liveness::worker_lock::{Owner, WorkerLock};
use crate::{Domain, clock};

/// Time before a refused port is looked up again, ns.
const REFUSED_FOR_NS: u64 = 10_000_000;

/// Distinguishes the worker's ports from those of other processes.
#[derive(Debug)]
pub(crate) struct WorkerPorts {
    lock_file: PathBuf,
    /// The port of the worker.
    port: Option<u128>,
    owner: Option<Owner>,
    runs: u64,
    /// The port refused last and the end of its refusal, monotonic ns.
    refused: Option<(u128, u64)>,
    foreign: u64,
}

impl WorkerPorts {
    pub(crate) fn new(domain: &Domain) -> Self {
        Self {
            lock_file: domain.worker_file(),
            port: None,
            owner: None,
            runs: 0,
            refused: None,
            foreign: 0,
        }
    }

    /// True if a frame from `port` is the worker's. Reads the lock file if the port is not the last
    /// one.
    pub(crate) fn admits(&mut self, port: u128) -> bool {
        if self.port == Some(port) {
            return true;
        }
        let now_ns = clock::monotonic_ns();
        let known = |(refused, until_ns): (u128, u64)| refused == port && now_ns < until_ns;
        if self.refused.is_some_and(known) {
            self.foreign += 1;
            return false;
        }
        let owner = WorkerLock::named_owner(&self.lock_file);
        match owner.filter(|owner| owner.port_pid == process_of(port)) {
            Some(owner) => {
                self.runs += u64::from(self.owner != Some(owner));
                (self.owner, self.port) = (Some(owner), Some(port));
                true
            }
            None => {
                self.refused = Some((port, now_ns.saturating_add(REFUSED_FOR_NS)));
                self.foreign += 1;
                false
            }
        }
    }

    /// Number of the worker's run of the last accepted frame, from 1.
    pub(crate) const fn runs(&self) -> u64 {
        self.runs
    }

    /// Number of frames that were not the worker's.
    pub(crate) const fn foreign(&self) -> u64 {
        self.foreign
    }
}

/// Process that created a port: a port id of iceoryx2 contains seconds, nanoseconds, pid and a
/// counter of 32 bits each.
fn process_of(port: u128) -> u32 {
    let bytes = port.to_ne_bytes();
    u32::from_ne_bytes([bytes[8], bytes[9], bytes[10], bytes[11]])
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn port(pid: u32, counter: u32) -> u128 {
        let words = [7_u32, 8, pid, counter];
        let mut bytes = [0; 16];
        for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_ne_bytes());
        }
        u128::from_ne_bytes(bytes)
    }

    fn ports(name: &str) -> WorkerPorts {
        let lock_file = std::env::temp_dir().join(format!("{name}-{}", std::process::id()));
        let domain = Domain::new("lab", std::path::Path::new("/dev/shm/nowhere"), "jb_").unwrap();
        WorkerPorts {
            lock_file,
            ..WorkerPorts::new(&domain)
        }
    }

    #[test]
    fn only_the_process_that_the_lock_names_is_admitted_and_each_holder_is_a_run() {
        let mut ports = ports("jb-ports");
        assert!(!ports.admits(port(10, 0)), "there is no worker");
        for (line, admitted, refused, runs) in [
            ("10 500\n", port(10, 0), port(11, 0), 1),
            // Another port of the same process, then the next lock holder; the previous one has
            // ended.
            ("10 500\n", port(10, 9), port(12, 0), 1),
            ("11 600\n", port(11, 1), port(10, 7), 2),
            // The same pid, later: another run.
            ("11 700\n", port(11, 2), port(10, 7), 3),
            // In a container the pid seen by iceoryx2 may be another one.
            ("1 800 4321\n", port(4321, 0), port(1, 0), 4),
        ] {
            fs::write(&ports.lock_file, line).unwrap();
            ports.refused = None;
            assert!(ports.admits(admitted), "{line}");
            assert!(!ports.admits(refused), "{line}");
            assert!(ports.admits(admitted), "{line}: once more");
            assert_eq!(ports.runs(), runs, "{line}");
        }
        for line in ["", "11", "11 900", "x y\n", "-1 900\n"] {
            fs::write(&ports.lock_file, line).unwrap();
            ports.refused = None;
            assert!(!ports.admits(port(11, 3)), "{line:?}");
        }
        fs::remove_file(&ports.lock_file).unwrap();
        assert!(ports.admits(port(4321, 0)), "frames of the last worker");
        assert!(ports.foreign() > 5);
    }
}
