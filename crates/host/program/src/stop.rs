//! Signals: those that ask a program to stop, and one that must not kill it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use anyhow::Context as _;
use rustix::time::{ClockId, clock_gettime};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};

/// Maximum delay of the exit by a sleep.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Whether one of them was requested, for what is deep inside a program.
static ASKED: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// True if signals set a flag in this process, and do not end it by themselves.
pub(crate) fn sets_a_flag() -> bool {
    ASKED.get().is_some()
}

/// True once a signal has requested the stop of this process.
pub(crate) fn is_asked_of_the_process() -> bool {
    ASKED.get().is_some_and(|asked| asked.load(Ordering::Relaxed))
}

/// Set by SIGINT, SIGTERM and SIGHUP. A second signal has no effect: the clean-up always runs.
#[derive(Debug, Clone)]
pub struct Stop {
    asked: Arc<AtomicBool>,
}

impl Stop {
    /// From now on the signals set the flag instead of killing the process. SIGHUP stays ignored
    /// where it is ignored at the start: `nohup` does that so that the process outlives its
    /// terminal.
    ///
    /// # Errors
    /// The signal handlers cannot be installed.
    pub fn on_signals() -> anyhow::Result<Self> {
        let asked = Arc::new(AtomicBool::new(false));
        let hangup = (!is_ignored(SIGHUP)).then_some(SIGHUP);
        for signal in [SIGINT, SIGTERM].into_iter().chain(hangup) {
            for flag in [&asked, ASKED.get_or_init(Arc::default)] {
                signal_hook::flag::register(signal, Arc::clone(flag))
                    .with_context(|| format!("cannot handle signal {signal}"))?;
            }
        }
        Ok(Self { asked })
    }

    /// True if a stop was requested.
    pub fn is_asked(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }

    /// The flag, for other waiting code.
    pub fn flag(&self) -> &AtomicBool {
        &self.asked
    }

    /// Sleeps until `deadline_ns` (monotonic) or until a stop is requested. Returns whether to
    /// continue.
    pub fn sleep_until(&self, deadline_ns: u64) -> bool {
        while !self.is_asked() {
            let left = Duration::from_nanos(deadline_ns.saturating_sub(monotonic_ns()));
            if left.is_zero() {
                return true;
            }
            std::thread::sleep(left.min(POLL_INTERVAL));
        }
        false
    }
}

/// CLOCK_MONOTONIC, ns.
fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    (now.tv_sec as u64) * 1_000_000_000 + now.tv_nsec as u64
}

/// Makes a write beyond the file size limit (`ulimit -f`) an error, as on a full disk, instead of
/// killing the process.
///
/// # Errors
/// The signal handler cannot be installed.
pub fn survive_file_limit() -> anyhow::Result<()> {
    signal_hook::flag::register(SIGXFSZ, Arc::default())
        .context("cannot handle the limit on the length of files")?;
    Ok(())
}

/// True if /proc reports the signal as ignored. False if it cannot be read.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
