//! Filter for frames on the worker's services: only those of the process that holds the worker's
//! lock are accepted.
//!
//! Every process of the user can send there. A frame of another process would otherwise be taken
//! for the worker's, and one with a run or a tick far in the future would hide all frames of the
//! worker.

use std::path::PathBuf;

use crate::liveness::worker_lock::{Owner, WorkerLock};
use crate::{Domain, clock};

/// Reads of the lock file are limited, from however many ports frames arrive: after
/// [`LOOKUPS_PER_PERIOD`] of them, the last result is used until the end of the period.
const LOOKUP_PERIOD_NS: u64 = 10_000_000;

/// At most 800 reads per second. A new worker's frames may be refused until the end of a period.
const LOOKUPS_PER_PERIOD: u32 = 8;

/// Distinguishes the worker's ports from those of other processes.
#[derive(Debug, Default)]
pub(crate) struct WorkerPorts {
    lock_file: PathBuf,
    port: Option<u128>,
    owner: Option<Owner>,
    runs: u64,
    /// The lock's holder at the last lookup.
    holder: Option<Owner>,
    lookups: u32,
    /// End of the period, monotonic ns.
    period_end_ns: u64,
    foreign: u64,
}

impl WorkerPorts {
    pub(crate) fn new(domain: &Domain) -> Self {
        Self { lock_file: domain.worker_file(), ..Self::default() }
    }

    /// True if a frame from `port` is the worker's. May read the lock file if the port is not the
    /// last one.
    pub(crate) fn admits(&mut self, port: u128) -> bool {
        if self.port == Some(port) {
            return true;
        }
        let holder = self.holder(clock::monotonic_ns());
        match holder.filter(|owner| owner.port_pid == process_of(port)) {
            Some(owner) => {
                self.runs += u64::from(self.owner != Some(owner));
                (self.owner, self.port) = (Some(owner), Some(port));
                true
            }
            None => {
                self.foreign += 1;
                false
            }
        }
    }

    /// The process that the lock file names.
    fn holder(&mut self, now_ns: u64) -> Option<Owner> {
        if now_ns >= self.period_end_ns {
            self.period_end_ns = now_ns.saturating_add(LOOKUP_PERIOD_NS);
            self.lookups = 0;
        }
        if self.lookups < LOOKUPS_PER_PERIOD {
            self.lookups += 1;
            self.holder = WorkerLock::named_owner(&self.lock_file);
        }
        self.holder
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
pub(crate) fn process_of(port: u128) -> u32 {
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
        WorkerPorts { lock_file, ..WorkerPorts::new(&domain) }
    }

    #[test]
    fn only_the_process_that_the_lock_names_is_admitted_and_each_holder_is_a_run() {
        let mut ports = ports("jb-ports");
        assert!(!ports.admits(port(10, 0)), "there is no worker");
        for (line, admitted, refused, runs) in [
            ("10 500\n", port(10, 0), port(11, 0), 1),
            // Another port of the same process, then the next lock holder. The previous one has
            // ended.
            ("10 500\n", port(10, 9), port(12, 0), 1),
            ("11 600\n", port(11, 1), port(10, 7), 2),
            // The same pid, later: another run.
            ("11 700\n", port(11, 2), port(10, 7), 3),
            // In a container the pid seen by iceoryx2 may be another one.
            ("1 800 4321\n", port(4321, 0), port(1, 0), 4),
        ] {
            fs::write(&ports.lock_file, line).unwrap();
            ports.lookups = 0;
            assert!(ports.admits(admitted), "{line}");
            assert!(!ports.admits(refused), "{line}");
            assert!(ports.admits(admitted), "{line}: once more");
            assert_eq!(ports.runs(), runs, "{line}");
        }
        for line in ["", "11", "11 900", "x y\n", "-1 900\n"] {
            fs::write(&ports.lock_file, line).unwrap();
            ports.lookups = 0;
            assert!(!ports.admits(port(11, 3)), "{line:?}");
        }
        fs::remove_file(&ports.lock_file).unwrap();
        assert!(ports.admits(port(4321, 0)), "frames of the last worker");
        assert!(ports.foreign() > 5);
    }

    #[test]
    fn frames_of_many_foreign_ports_cause_a_bounded_number_of_reads_and_do_not_hide_a_new_worker() {
        let mut ports = ports("jb-port-flood");
        let mut lookups = 0;
        for period in 0..100_u64 {
            let now_ns = period * LOOKUP_PERIOD_NS;
            for _ in 0..1000 {
                assert_eq!(ports.holder(now_ns), None);
            }
            lookups += ports.lookups;
        }
        assert_eq!(lookups, 100 * LOOKUPS_PER_PERIOD);
        fs::write(&ports.lock_file, "10 500\n").unwrap();
        let next_ns = 100 * LOOKUP_PERIOD_NS;
        assert_eq!(ports.holder(next_ns).map(|owner| owner.pid), Some(10));
        fs::remove_file(&ports.lock_file).unwrap();
    }
}
