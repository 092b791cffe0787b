//! SIGINT and SIGTERM.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use joulebus_bus::clock;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Maximum delay of the exit by a sleep.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Set by SIGINT and SIGTERM. A second signal has no effect: the clean-up always runs.
#[derive(Debug, Clone)]
pub struct Stop {
    asked: Arc<AtomicBool>,
}

impl Stop {
    /// From now on the two signals set the flag instead of killing the process.
    ///
    /// # Errors
    /// The signal handlers cannot be installed.
    pub fn on_signals() -> anyhow::Result<Self> {
        let asked = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register(signal, Arc::clone(&asked))
                .with_context(|| format!("cannot handle signal {signal}"))?;
        }
        Ok(Self { asked })
    }

    /// Also stops when the terminal is closed (SIGHUP): for programs that display in it.
    ///
    /// # Errors
    /// The signal handler cannot be installed.
    pub fn or_hangup(self) -> anyhow::Result<Self> {
        signal_hook::flag::register(SIGHUP, Arc::clone(&self.asked))
            .context("cannot handle the end of the terminal")?;
        Ok(self)
    }

    /// Whether a stop was requested.
    pub fn is_asked(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }

    /// The flag, for other waiting code.
    pub fn flag(&self) -> &AtomicBool {
        &self.asked
    }

    /// Sleeps until `deadline_ns` (monotonic) or until a stop is requested; returns whether to
    /// continue.
    pub fn sleep_until(&self, deadline_ns: u64) -> bool {
        while !self.is_asked() {
            let left = Duration::from_nanos(deadline_ns.saturating_sub(clock::monotonic_ns()));
            if left.is_zero() {
                return true;
            }
            std::thread::sleep(left.min(LOOK_EVERY));
        }
        false
    }
}
