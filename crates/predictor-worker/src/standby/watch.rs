//! Whether this host's worker may send now: read by the tick, kept up to date by a thread.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use joulebus_bus::{Background, Steps};
use joulebus_standby::{Permit, PermitError};

/// How often the permit's file is read.
pub(crate) const READ_EVERY: Duration = Duration::from_millis(50);

/// The permit has run out, or was withdrawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the permit to serve in term {term} has ended: another host's worker may serve from now on; \
     start this one again, and it stands by"
)]
pub struct PermitOver {
    /// Term of the permit.
    pub term: u64,
}

/// What the tick reads before it sends.
#[derive(Debug)]
pub(crate) struct Speaking {
    until_ns: AtomicU64,
    /// 0: of a worker that needs no permit, or has none yet.
    term: AtomicU64,
}

impl Speaking {
    /// Of a worker that needs no permit.
    pub(crate) const fn always() -> Self {
        Self {
            until_ns: AtomicU64::new(u64::MAX),
            term: AtomicU64::new(0),
        }
    }

    /// Of a worker that waits for one.
    pub(crate) const fn not_yet() -> Self {
        Self {
            until_ns: AtomicU64::new(0),
            term: AtomicU64::new(0),
        }
    }

    /// Whether a frame may be sent at `now_ns`, since boot with suspend.
    pub(crate) fn holds(&self, now_ns: u64) -> bool {
        let until_ns = self.until_ns.load(Ordering::Acquire);
        now_ns < until_ns || until_ns == u64::MAX
    }

    /// Term of the permit; 0 without one.
    pub(crate) fn term(&self) -> u64 {
        self.term.load(Ordering::Acquire)
    }

    pub(crate) fn over(&self) -> PermitOver {
        PermitOver { term: self.term() }
    }

    /// The first permit.
    pub(crate) fn begin(&self, permit: &Permit) {
        self.term.store(permit.term, Ordering::Release);
        self.renew(Some(permit));
    }

    /// What the file says now. A permit of another term is not this worker's: it may not have been alone in between.
    fn renew(&self, permit: Option<&Permit>) {
        let own = permit.filter(|permit| permit.term == self.term());
        let until_ns = own.map_or(0, |permit| permit.until_ns.unwrap_or(u64::MAX));
        self.until_ns.store(until_ns, Ordering::Release);
    }
}

/// Reads the permit's file again and again. A permit that ended is not begun again.
struct Renewal {
    path: PathBuf,
    speaking: Arc<Speaking>,
    is_told: bool,
}

/// Begins to serve by the first permit, and keeps `speaking` up to date with the one in the file: that may have been renewed
/// since the first was read, by when a large fleet was restored.
pub(crate) fn start(
    path: PathBuf,
    speaking: Arc<Speaking>,
    first: &Permit,
) -> std::io::Result<Background> {
    speaking.begin(first);
    let mut renewal = Renewal {
        path,
        speaking,
        is_told: false,
    };
    renewal.step(false);
    Background::start("joulebus-permit", move || Ok::<_, std::io::Error>(renewal))
}

impl Steps for Renewal {
    fn step(&mut self, last: bool) -> Option<Duration> {
        match Permit::read(&self.path) {
            Ok(permit) => {
                self.speaking.renew(permit.as_ref());
                if permit.is_none_or(|permit| permit.term != self.speaking.term()) {
                    return None;
                }
            }
            Err(error) => self.tell(&error),
        }
        (!last).then_some(READ_EVERY)
    }
}

impl Renewal {
    /// What cannot be read extends nothing: the worker serves for as long as it was told last.
    fn tell(&mut self, error: &PermitError) {
        if !self.is_told {
            tracing::warn!(%error, "the permit cannot be read");
        }
        self.is_told = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERMIT: Permit = Permit {
        term: 4,
        until_ns: Some(100),
        lease: 9,
    };

    #[test]
    fn a_worker_speaks_until_its_permit_ends_and_never_with_that_of_another_term() {
        assert!(Speaking::always().holds(u64::MAX));
        let speaking = Speaking::not_yet();
        assert!(!speaking.holds(0));
        speaking.begin(&PERMIT);
        assert!(speaking.holds(99) && !speaking.holds(100));
        speaking.renew(Some(&Permit {
            until_ns: Some(200),
            ..PERMIT
        }));
        assert!(speaking.holds(199));
        speaking.renew(Some(&Permit {
            until_ns: None,
            ..PERMIT
        }));
        assert!(speaking.holds(u64::MAX - 1));
        for permit in [
            None,
            Some(Permit { term: 5, ..PERMIT }),
            Some(Permit { term: 3, ..PERMIT }),
        ] {
            speaking.begin(&PERMIT);
            speaking.renew(permit.as_ref());
            assert!(!speaking.holds(0), "{permit:?}");
        }
        assert_eq!(speaking.over().term, 4);
    }

    #[test]
    fn a_permit_that_was_renewed_while_the_state_was_restored_counts_from_the_beginning() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("permit-lab");
        for (renewed, until_ns) in [
            (Some(PERMIT), 100),
            (
                Some(Permit {
                    until_ns: Some(300),
                    ..PERMIT
                }),
                300,
            ),
            (Some(Permit { term: 5, ..PERMIT }), 0),
            (None, 0),
        ] {
            match &renewed {
                Some(permit) => permit.write(&path).unwrap(),
                None => Permit::withdraw(&path).unwrap(),
            }
            let speaking = Arc::new(Speaking::not_yet());
            let mut thread = start(path.clone(), Arc::clone(&speaking), &PERMIT).unwrap();
            assert_eq!(speaking.until_ns.load(Ordering::Acquire), until_ns);
            assert_eq!(speaking.term(), 4);
            thread.finish().unwrap();
        }
    }

    #[test]
    fn a_withdrawn_permit_ends_the_thread_and_one_that_cannot_be_read_extends_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("permit-lab");
        let speaking = Arc::new(Speaking::not_yet());
        speaking.begin(&PERMIT);
        let mut renewal = Renewal {
            path: path.clone(),
            speaking: Arc::clone(&speaking),
            is_told: false,
        };
        std::fs::write(&path, "nonsense").unwrap();
        assert_eq!(renewal.step(false), Some(READ_EVERY));
        assert!(speaking.holds(99) && !speaking.holds(100));
        let later = Permit {
            until_ns: Some(300),
            ..PERMIT
        };
        later.write(&path).unwrap();
        assert_eq!(renewal.step(false), Some(READ_EVERY));
        assert!(speaking.holds(299));
        Permit::withdraw(&path).unwrap();
        assert_eq!(renewal.step(false), None);
        assert!(!speaking.holds(0));
    }
}
