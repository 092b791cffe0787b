//! State shared by the threads of a bridge.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use joulebus_program::output::say;

use crate::mapping::account::Account;
use crate::mapping::intake::Intake;
use crate::mapping::route::State;

/// Maximum number of states that wait to be passed on.
const MAX_STATES: usize = 1_000;

/// The newest observations, the account of unmapped messages, and the stop flags.
#[derive(Debug)]
pub(crate) struct Shared {
    intake: Mutex<Intake>,
    account: Mutex<Account>,
    states: Mutex<VecDeque<State>>,
    stop: AtomicBool,
    close: AtomicBool,
    messages: AtomicU64,
}

impl Shared {
    pub(crate) fn new(intake: Intake) -> Self {
        Self {
            intake: Mutex::new(intake),
            account: Mutex::default(),
            states: Mutex::default(),
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

    /// Logs each unmapped message of a new reason or name, and each new implausible value.
    pub(crate) fn log_news(&self) {
        let news = self.account().take_news();
        for line in news {
            say(&format!("not mapped: {line}"));
        }
        let news = self.intake().judgement().take_news();
        for line in news {
            say(&format!("implausible: {line}"));
        }
    }

    /// Adds states to pass on. Beyond the maximum the oldest are dropped: later ones replace them.
    pub(crate) fn add_states(&self, new: Vec<State>) {
        let mut states = lock(&self.states);
        states.extend(new);
        let excess = states.len().saturating_sub(MAX_STATES);
        states.drain(..excess);
    }

    /// The states to pass on since the last call.
    pub(crate) fn take_states(&self) -> VecDeque<State> {
        std::mem::take(&mut lock(&self.states))
    }

    /// Counts a received message.
    pub(crate) fn count_message(&self) {
        self.messages.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of messages received.
    pub(crate) fn messages(&self) -> u64 {
        self.messages.load(Ordering::Relaxed)
    }

    /// Tells the threads that use shared memory to end.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Tells the connections to end after they have sent their queues.
    pub(crate) fn close(&self) {
        self.close.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.close.load(Ordering::Relaxed)
    }
}

/// Ignores poisoning: no panic leaves the guarded data inconsistent.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
