//! What every benchmark prints first: the machine, the build, and what is measured.
#![forbid(unsafe_code)]

pub mod latency;

use std::fs;

use hdrhistogram::Histogram;
pub use joulebus_predictor_worker::Spread;
use serde::Serialize;

/// The machine and the build that a figure belongs to.
#[derive(Debug, Clone, Serialize)]
pub struct Machine {
    /// Model name of the processor.
    pub processor: String,
    /// Processors that this process may use.
    pub processors: usize,
    /// Frequency governor, where the system tells.
    pub governor: String,
    /// Kernel.
    pub kernel: String,
    /// Version of joulebus.
    pub version: &'static str,
    /// Build profile.
    pub profile: &'static str,
    /// Kernel of the model that was dispatched.
    pub dispatched: String,
}

impl Machine {
    /// This machine; `dispatched` names the model's kernel.
    #[must_use]
    pub fn here(dispatched: String) -> Self {
        let cpuinfo = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let processor = cpuinfo
            .lines()
            .find_map(|line| line.strip_prefix("model name")?.split(": ").nth(1))
            .unwrap_or("unknown");
        let read = |path: &str| fs::read_to_string(path).map(|text| text.trim().to_owned());
        Self {
            processor: processor.to_owned(),
            processors: std::thread::available_parallelism().map_or(1, usize::from),
            governor: read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
                .unwrap_or_else(|_| "not told".to_owned()),
            kernel: read("/proc/sys/kernel/osrelease").unwrap_or_default(),
            version: env!("CARGO_PKG_VERSION"),
            profile: if cfg!(debug_assertions) {
                "dev"
            } else {
                "release"
            },
            dispatched,
        }
    }
}

/// A distribution in one line, µs: p50, p99, p99.9, max.
#[must_use]
pub fn line(spread: &Spread) -> String {
    let Spread {
        p50_us,
        p99_us,
        p999_us,
        max_us,
        ..
    } = spread;
    format!("{p50_us:>9.1} {p99_us:>9.1} {p999_us:>9.1} {max_us:>9.1}")
}

/// A histogram of ns up to a minute, three digits.
///
/// # Panics
/// Never: the bounds are constant and valid.
#[must_use]
pub fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3)
        .expect("1 ns to 1 min in three digits is valid")
}
