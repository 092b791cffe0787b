//! What the threads of a bridge share.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use joulebus_program::output::say;

use crate::mapping::account::Account;
use crate::mapping::intake::Intake;

/// What was heard, and what was not mapped.
#[derive(Debug)]
pub(crate) struct Shared {
    intake: Mutex<Intake>,
    account: Mutex<Account>,
    stop: AtomicBool,
    close: AtomicBool,
    messages: AtomicU64,
}

impl Shared {
    pub(crate) fn new(intake: Intake) -> Self {
        Self {
            intake: Mutex::new(intake),
            account: Mutex::default(),
            stop: AtomicBool::new(false),
            close: AtomicBool::new(false),
            messages: AtomicU64::new(0),
        }
    }

    pub(crate) fn intake(&self) -> MutexGuard<'_, Intake> {
        lock(&self.intake)
    }

    pub(crate) fn account(&self) -> MutexGuard<'_, Account> {
        lock(&self.account)
    }

    /// Says what was not mapped for the first time.
    pub(crate) fn say_news(&self) {
        let news = self.account().take_news();
        for line in news {
            say(&format!("not mapped: {line}"));
        }
    }

    /// Counts a message that came.
    pub(crate) fn count_message(&self) {
        self.messages.fetch_add(1, Ordering::Relaxed);
    }

    /// Messages that came.
    pub(crate) fn messages(&self) -> u64 {
        self.messages.load(Ordering::Relaxed)
    }

    /// Lets the threads end that read and write shared memory.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Lets connections end, after they have sent what they were handed.
    pub(crate) fn close(&self) {
        self.close.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.close.load(Ordering::Relaxed)
    }
}

/// What the lock guards is whole whenever a thread panics.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
