//! Permission of this host's worker to send: read by the tick, kept up to date by a thread.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use joulebus_bus::{Background, Steps, clock};
use joulebus_connect::standby::{Permit, PermitError};

pub(crate) const THREAD: &str = "joulebus-permit";
/// Interval of reading the permit's file.
pub(crate) const READ_EVERY: Duration = Duration::from_millis(50);

/// The permit has run out, or was withdrawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the permit to serve in term {term} has ended: another host's worker may serve from now on. \
        Start this one again, and it stands by"
)]
pub struct PermitOver {
    /// Term of the permit.
    pub term: u64,
}

/// The permit as the tick reads it before it sends.
#[derive(Debug)]
pub(crate) struct CurrentPermit {
    until_ns: AtomicU64,
    /// 0: of a worker that needs no permit, or has none yet.
    term: AtomicU64,
}

impl CurrentPermit {
    /// The permit of a worker that needs none.
    pub(crate) const fn always() -> Self {
        Self { until_ns: AtomicU64::new(u64::MAX), term: AtomicU64::new(0) }
    }

    /// The permit of a worker that waits for one.
    pub(crate) const fn not_yet() -> Self {
        Self { until_ns: AtomicU64::new(0), term: AtomicU64::new(0) }
    }

    /// True if a frame may be sent at `now_ns`, since boot with suspend.
    pub(crate) fn holds(&self, now_ns: u64) -> bool {
        let until_ns = self.until_ns.load(Ordering::Acquire);
        now_ns < until_ns || until_ns == u64::MAX
    }

    /// Term of the permit. 0 without one.
    pub(crate) fn term(&self) -> u64 {
        self.term.load(Ordering::Acquire)
    }

    pub(crate) fn over(&self) -> PermitOver {
        PermitOver { term: self.term() }
    }

    pub(crate) fn begin(&self, permit: &Permit) {
        self.term.store(permit.term, Ordering::Release);
        self.renew(Some(permit));
    }

    /// Applies the file's contents. Returns whether the permit holds now.
    pub(crate) fn read_again(&self, permit: Option<&Permit>) -> bool {
        self.renew(permit);
        self.holds(clock::boot_ns())
    }

    /// Applies the file's contents. A permit of another term is not this worker's, because another
    /// may have led in between.
    fn renew(&self, permit: Option<&Permit>) {
        let own = permit.filter(|permit| permit.term == self.term());
        let until_ns = own.map_or(0, |permit| permit.until_ns);
        self.until_ns.store(until_ns, Ordering::Release);
    }
}

/// Reads the permit's file again and again. A permit that ended is not begun again.
struct Renewal {
    path: PathBuf,
    current_permit: Arc<CurrentPermit>,
    is_logged: bool,
}

/// Begins to serve by the first permit, and keeps `current_permit` up to date with the one in the
/// file: that may have been renewed since the first was read, by when a large fleet was restored.
pub(crate) fn start(
    path: PathBuf,
    current_permit: Arc<CurrentPermit>,
    first: &Permit,
) -> std::io::Result<Background> {
    current_permit.begin(first);
    let mut renewal = Renewal { path, current_permit, is_logged: false };
    renewal.step(false);
    Background::start(THREAD, move || Ok::<_, std::io::Error>(renewal))
}

impl Steps for Renewal {
    fn step(&mut self, last: bool) -> Option<Duration> {
        match Permit::read(&self.path) {
            Ok(permit) => {
                self.current_permit.renew(permit.as_ref());
                if permit.is_none_or(|permit| permit.term != self.current_permit.term()) {
                    return None;
                }
            }
            Err(error) => self.log_failure(&error),
        }
        (!last).then_some(READ_EVERY)
    }
}

impl Renewal {
    /// Logs a read error once. An unreadable file extends nothing: the worker serves until the last
    /// known end.
    fn log_failure(&mut self, error: &PermitError) {
        if !self.is_logged {
            tracing::warn!(%error, "the permit cannot be read");
        }
        self.is_logged = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERMIT: Permit = Permit { term: 4, until_ns: 100, lease: 9 };

    #[test]
    fn a_worker_sends_until_its_permit_ends_and_never_with_that_of_another_term() {
        assert!(CurrentPermit::always().holds(u64::MAX));
        let current_permit = CurrentPermit::not_yet();
        assert!(!current_permit.holds(0));
        current_permit.begin(&PERMIT);
        assert!(current_permit.holds(99) && !current_permit.holds(100));
        current_permit.renew(Some(&Permit { until_ns: 200, ..PERMIT }));
        assert!(current_permit.holds(199));
        for permit in [None, Some(Permit { term: 5, ..PERMIT }), Some(Permit { term: 3, ..PERMIT })]
        {
            current_permit.begin(&PERMIT);
            current_permit.renew(permit.as_ref());
            assert!(!current_permit.holds(0), "{permit:?}");
        }
        assert_eq!(current_permit.over().term, 4);
    }

    #[test]
    fn a_permit_that_was_renewed_while_the_state_was_restored_counts_from_the_beginning() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("permit-lab");
        for (renewed, until_ns) in [
            (Some(PERMIT), 100),
            (Some(Permit { until_ns: 300, ..PERMIT }), 300),
            (Some(Permit { term: 5, ..PERMIT }), 0),
            (None, 0),
        ] {
            match &renewed {
                Some(permit) => permit.write(&path).unwrap(),
                None => Permit::withdraw(&path).unwrap(),
            }
            let current_permit = Arc::new(CurrentPermit::not_yet());
            let mut thread = start(path.clone(), Arc::clone(&current_permit), &PERMIT).unwrap();
            assert_eq!(current_permit.until_ns.load(Ordering::Acquire), until_ns);
            assert_eq!(current_permit.term(), 4);
            thread.finish().unwrap();
        }
    }

    #[test]
    fn a_withdrawn_permit_ends_the_thread_and_one_that_cannot_be_read_extends_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("permit-lab");
        let current_permit = Arc::new(CurrentPermit::not_yet());
        current_permit.begin(&PERMIT);
        let mut renewal = Renewal {
            path: path.clone(),
            current_permit: Arc::clone(&current_permit),
            is_logged: false,
        };
        std::fs::write(&path, "nonsense").unwrap();
        assert_eq!(renewal.step(false), Some(READ_EVERY));
        assert!(current_permit.holds(99) && !current_permit.holds(100));
        let later = Permit { until_ns: 300, ..PERMIT };
        later.write(&path).unwrap();
        assert_eq!(renewal.step(false), Some(READ_EVERY));
        assert!(current_permit.holds(299));
        Permit::withdraw(&path).unwrap();
        assert_eq!(renewal.step(false), None);
        assert!(!current_permit.holds(0));
    }
}
