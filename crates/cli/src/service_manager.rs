//! Messages to a service manager (systemd's `Type=notify`): ready, stopping, and the watchdog's.
//!
//! Without `$NOTIFY_SOCKET` nothing is sent.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use joulebus_bus::{Background, Steps};
use sd_notify::NotifyState;

/// The service manager that started this process, if one did.
pub(crate) struct ServiceManager {
    watchdog: Option<Background>,
}

impl ServiceManager {
    /// Starts the thread that reports as long as `turns` grows, if the service has a watchdog
    /// (`WatchdogSec=`). Call it before the worker is opened, whose CPUs and priority it would
    /// inherit.
    pub(crate) fn start(turns: Arc<AtomicU64>) -> io::Result<Self> {
        let watchdog = sd_notify::watchdog_enabled().map(|within| {
            Background::start("joulebus-watchdog", move || {
                Ok::<_, io::Error>(Watchdog {
                    every: within / 3,
                    seen: turns.load(Ordering::Relaxed),
                    turns,
                })
            })
        });
        Ok(Self { watchdog: watchdog.transpose()? })
    }

    /// The service is ready. `status` is one line for operators.
    pub(crate) fn ready(&self, status: &str) {
        notify(&[NotifyState::Ready, NotifyState::Status(status)]);
    }

    pub(crate) fn stopping(mut self) {
        if let Some(Err(error)) = self.watchdog.as_mut().map(Background::finish) {
            tracing::error!("{error}");
        }
        notify(&[NotifyState::Stopping]);
    }
}

/// Reports to the service manager whenever the worker has worked since the last report. A worker
/// that is not open yet does nothing: starting has a limit of its own.
struct Watchdog {
    every: Duration,
    turns: Arc<AtomicU64>,
    seen: u64,
}

impl Steps for Watchdog {
    fn step(&mut self, last: bool) -> Option<Duration> {
        let turns = self.turns.load(Ordering::Relaxed);
        if turns != self.seen {
            self.seen = turns;
            notify(&[NotifyState::Watchdog]);
        }
        (!last).then_some(self.every)
    }
}

fn notify(what: &[NotifyState]) {
    if let Err(error) = sd_notify::notify(what) {
        tracing::warn!(%error, "the service manager cannot be notified");
    }
}
