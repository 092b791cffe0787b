//! State shared by the threads of a bridge.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_program::output::log_line;

use crate::mapping::account::Account;
use crate::mapping::intake::Intake;
use crate::mapping::simulated::SimulatedClock;

/// Nice value of the threads that serve connections, so that the worker and its sources run first.
pub(crate) const NICE: u8 = 5;

/// The newest observations, the account of unmapped messages, and the flag of the connections.
#[derive(Debug)]
pub(crate) struct Shared {
    intake: Mutex<Intake>,
    account: Mutex<Account>,
    simulated: Option<Mutex<SimulatedClock>>,
    /// The simulated clock has moved.
    moved: Condvar,
    close: AtomicBool,
    messages: AtomicU64,
}

impl Shared {
    /// With the clock of a simulation, if samples have its time.
    pub(crate) fn new(intake: Intake, simulated: Option<SimulatedClock>) -> Self {
        Self {
            intake: Mutex::new(intake),
            account: Mutex::default(),
            simulated: simulated.map(Mutex::new),
            moved: Condvar::new(),
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

    /// The simulated clock, if samples have its time.
    pub(crate) fn simulated(&self) -> Option<MutexGuard<'_, SimulatedClock>> {
        self.simulated.as_ref().map(lock)
    }

    /// The present in the time of samples, ns: this host's monotonic clock, or the place of the
    /// simulated time on it. `None` before a message of `/clock`.
    pub(crate) fn now_ns(&self) -> Option<u64> {
        let Some(simulated) = self.simulated() else { return Some(clock::monotonic_ns()) };
        simulated.now_ns().map(|(stamp_ns, _)| stamp_ns)
    }

    /// Takes a message of `/clock`.
    pub(crate) fn set_clock(&self, sim_ns: u64) {
        let host_ns = clock::monotonic_ns();
        if self.simulated().is_some_and(|mut simulated| simulated.take(sim_ns, host_ns)) {
            self.intake().forget();
        }
        self.moved.notify_all();
    }

    /// Waits until the simulated clock moves, at most this time. A clock of this host moves by
    /// itself: returns the time to wait for it.
    pub(crate) fn wait(&self, most: Duration) -> Duration {
        let Some(simulated) = self.simulated() else { return most };
        // The clock or the timeout may have ended the wait: both are fine.
        drop(self.moved.wait_timeout(simulated, most));
        Duration::ZERO
    }

    /// Logs what is new about the simulated clock.
    pub(crate) fn log_clock(&self) {
        let news = self.simulated().and_then(|mut simulated| simulated.news(clock::monotonic_ns()));
        if let Some(line) = news {
            log_line(&line);
        }
    }

    /// Logs each unmapped message of a new reason or name, and each new implausible value.
    pub(crate) fn log_news(&self) {
        let news = self.account().take_news();
        for line in news {
            log_line(&format!("not mapped: {line}"));
        }
        let news = self.intake().judgement().take_news();
        for line in news {
            log_line(&format!("implausible: {line}"));
        }
    }

    /// Counts a received message.
    pub(crate) fn count_message(&self) {
        self.messages.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of messages received.
    pub(crate) fn messages(&self) -> u64 {
        self.messages.load(Ordering::Relaxed)
    }

    /// Requests the connections to end after they have sent their queues.
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
