//! A `fork` waits until no thread is in iceoryx2's process-wide locks.
//!
//! A child has no thread but the one that forked. A lock that another thread of the parent held
//! stays locked in the child for good. iceoryx2 looks at nodes under such a lock, so the child's
//! first join would hang. Cleanup threads look once a second. A controller may fork at any time.
#![allow(unsafe_code)] // Registers functions with the C library.

use std::sync::Once;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Threads between [`enter`] and the end of their [`Section`].
static INSIDE: AtomicUsize = AtomicUsize::new(0);
/// Forks that wait or happen: nobody enters.
static FORKS: AtomicUsize = AtomicUsize::new(0);

const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Maximum wait of a fork: a cleanup that hangs must not hang the program around it.
const MAX_WAIT: Duration = Duration::from_secs(5);

/// While it lives, a fork waits. Sections of one thread are not nested.
#[derive(Debug)]
pub(crate) struct Section(());

impl Drop for Section {
    fn drop(&mut self) {
        INSIDE.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Waits while another thread forks.
pub(crate) fn enter() -> Section {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(register);
    loop {
        INSIDE.fetch_add(1, Ordering::SeqCst);
        let section = Section(());
        if FORKS.load(Ordering::SeqCst) == 0 {
            return section;
        }
        drop(section);
        sleep(POLL_INTERVAL);
    }
}

fn register() {
    // SAFETY: the handlers take nothing, use only atomics and the clock, and do not unwind. They
    // stay where they are: neither a program nor libjoulebus is unloaded.
    let error = unsafe { libc::pthread_atfork(Some(prepare), Some(in_parent), Some(in_child)) };
    if error != 0 {
        tracing::warn!(error, "a child of this process may wait for ever when it joins");
    }
}

extern "C" fn prepare() {
    FORKS.fetch_add(1, Ordering::SeqCst);
    let begin = Instant::now();
    while INSIDE.load(Ordering::SeqCst) > 0 && begin.elapsed() < MAX_WAIT {
        sleep(POLL_INTERVAL);
    }
}

extern "C" fn in_parent() {
    FORKS.fetch_sub(1, Ordering::SeqCst);
}

/// Its only thread is the one that forked, which was not inside.
extern "C" fn in_child() {
    FORKS.store(0, Ordering::SeqCst);
    INSIDE.store(0, Ordering::SeqCst);
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn a_fork_waits_for_threads_inside_and_others_wait_for_the_fork() {
        let section = enter();
        let (forks, forked) = channel();
        let (enters, entered) = channel();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                prepare();
                forks.send(()).unwrap();
            });
            while FORKS.load(Ordering::SeqCst) == 0 {
                sleep(POLL_INTERVAL);
            }
            scope.spawn(move || {
                drop(enter());
                enters.send(()).unwrap();
            });
            sleep(20 * POLL_INTERVAL);
            assert!(forked.try_recv().is_err());
            drop(section);
            forked.recv().unwrap();
            sleep(20 * POLL_INTERVAL);
            assert!(entered.try_recv().is_err());
            in_parent();
            entered.recv().unwrap();
        });
    }
}
