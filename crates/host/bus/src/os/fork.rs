//! A `fork` waits until no thread holds a process-wide lock, of ours or of iceoryx2.
//!
//! A child has no thread but the one that forked. A lock that another thread of the parent held
//! stays locked in the child for good. iceoryx2 looks at nodes and removes them under such locks,
//! so the child's first join would hang. Cleanup threads look once a second. A controller may fork
//! at any time.
//!
//! `statics` in `tests/tests/repository` lists what must stand behind a [`Section`].
#![allow(unsafe_code)] // Registers functions with the C library.

use std::cell::Cell;
use std::marker::PhantomData;
use std::process;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Threads between [`enter`] and the end of their [`Section`].
static INSIDE: AtomicUsize = AtomicUsize::new(0);
/// Forks that wait or happen: nobody enters.
static FORKS: AtomicUsize = AtomicUsize::new(0);
/// Progress of registering with the C library: 0, the process whose thread does it, or [`DONE`].
/// Not a `Once`: that would be such a lock. A child whose parent was registering does it itself.
static REGISTERED: AtomicU32 = AtomicU32::new(0);
/// No process has this id.
const DONE: u32 = u32::MAX;

thread_local! {
    /// Sections of this thread, one within another.
    static SECTIONS: Cell<usize> = const { Cell::new(0) };
}

const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Maximum wait of a fork: a cleanup that hangs must not hang the program around it.
const MAX_WAIT: Duration = Duration::from_secs(5);

/// While it lives, a `fork` by another thread waits, at most five seconds. To be held around every
/// process-wide lock. A thread that holds one must not wait for another thread that enters one.
#[derive(Debug)]
pub struct ForkSection {
    /// It belongs to its thread.
    thread: PhantomData<*const ()>,
}

impl Drop for ForkSection {
    fn drop(&mut self) {
        let outer = SECTIONS.get() - 1;
        SECTIONS.set(outer);
        if outer == 0 {
            INSIDE.fetch_sub(1, Ordering::SeqCst);
        }
    }
}

impl ForkSection {
    /// Waits while another thread forks. Within another section it does not wait.
    #[must_use]
    pub fn enter() -> Self {
        let outer = SECTIONS.get();
        if outer == 0 {
            if REGISTERED.load(Ordering::Acquire) != DONE {
                register();
            }
            loop {
                INSIDE.fetch_add(1, Ordering::SeqCst);
                if FORKS.load(Ordering::SeqCst) == 0 {
                    break;
                }
                INSIDE.fetch_sub(1, Ordering::SeqCst);
                sleep(POLL_INTERVAL);
            }
        }
        SECTIONS.set(outer + 1);
        Self { thread: PhantomData }
    }
}

/// What this thread adds to [`INSIDE`].
fn own() -> usize {
    usize::from(SECTIONS.get() > 0)
}

/// Waits while another thread registers.
fn register() {
    let own = process::id();
    loop {
        match REGISTERED.load(Ordering::Acquire) {
            DONE => return,
            found if found == own => sleep(POLL_INTERVAL),
            found => {
                let (done, failed) = (Ordering::AcqRel, Ordering::Acquire);
                if REGISTERED.compare_exchange(found, own, done, failed).is_ok() {
                    break;
                }
            }
        }
    }
    // SAFETY: the handlers take nothing, use only atomics and the clock, and do not unwind. They
    // stay where they are: neither a program nor libjoulebus is unloaded.
    let error = unsafe { libc::pthread_atfork(Some(prepare), Some(in_parent), Some(in_child)) };
    if error != 0 {
        tracing::warn!(error, "a child of this process may wait for ever when it joins");
    }
    REGISTERED.store(DONE, Ordering::Release);
}

extern "C" fn prepare() {
    FORKS.fetch_add(1, Ordering::SeqCst);
    let begin = Instant::now();
    while INSIDE.load(Ordering::SeqCst) > own() && begin.elapsed() < MAX_WAIT {
        sleep(POLL_INTERVAL);
    }
}

extern "C" fn in_parent() {
    FORKS.fetch_sub(1, Ordering::SeqCst);
}

/// Its only thread is the one that forked.
extern "C" fn in_child() {
    FORKS.store(0, Ordering::SeqCst);
    INSIDE.store(own(), Ordering::SeqCst);
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn a_fork_waits_for_threads_inside_and_others_wait_for_the_fork() {
        let section = ForkSection::enter();
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
                drop(ForkSection::enter());
                enters.send(()).unwrap();
            });
            // Neither its thread's next section waits, nor does its end let the fork go on.
            drop(ForkSection::enter());
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
