//! One process at a time removes what dead processes have left of services.

use std::fs::File;
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, flock};

use crate::Domain;
use crate::directory::SERVICES;
use crate::marker::open_directory;

/// Longest wait: the holder may be stopped by a signal.
const PATIENCE: Duration = Duration::from_millis(500);
const TRY_EVERY: Duration = Duration::from_millis(2);

/// The exclusive right to remove nodes and services, among the processes of a domain. The kernel
/// gives it back when its holder ends.
///
/// iceoryx2 0.10 locks each dead node, not the services that dead nodes share (#1578, #897, #21).
/// One process may read the description of a service, and another removes its last node and the
/// service. A third creates the service anew. The first finds no list of ports of the old service,
/// and removes the new description, by name.
#[derive(Debug)]
pub(crate) struct Turn {
    _lock: Option<File>,
}

impl Turn {
    /// Waits at most half a second until no other process has the turn. Then, or where no folder of
    /// services can be locked, goes on without it.
    pub(crate) fn take(domain: &Domain) -> Self {
        let Ok(folder) = open_directory(&domain.directory().join(SERVICES)) else {
            return Self { _lock: None };
        };
        let begin = Instant::now();
        while flock(&folder, FlockOperation::NonBlockingLockExclusive).is_err() {
            if begin.elapsed() > PATIENCE {
                tracing::warn!(
                    "another process has been removing what dead ones left for half a second: going on beside it"
                );
                return Self { _lock: None };
            }
            sleep(TRY_EVERY);
        }
        Self {
            _lock: Some(folder),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_process_at_a_time_has_the_turn_and_a_stopped_one_is_not_waited_for() {
        let root = std::env::temp_dir().join(format!("joulebus-turn-{}", std::process::id()));
        let domain = Domain::new("turn", &root, "jbturn_").unwrap();
        std::fs::create_dir_all(domain.directory().join(SERVICES)).unwrap();
        let held = Turn::take(&domain);
        let begin = Instant::now();
        let without = Turn::take(&domain);
        let waited = begin.elapsed();
        drop(held);
        let next = Turn::take(&domain);
        let is_locked = |turn: &Turn| turn._lock.is_some();
        assert_eq!((is_locked(&without), is_locked(&next)), (false, true));
        assert!(waited >= PATIENCE, "{waited:?}");
        std::fs::remove_dir_all(&root).unwrap();
    }
}
