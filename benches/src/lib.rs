//! What every benchmark prints first: the machine, the build, and what is measured.
#![forbid(unsafe_code)]

use std::fs;

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

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

/// Distribution of a time, µs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Values.
    pub count: u64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Greatest.
    pub max: f64,
}

impl Spread {
    /// From a histogram of ns.
    #[must_use]
    pub fn of(histogram: &Histogram<u64>) -> Self {
        let us = |quantile| histogram.value_at_quantile(quantile) as f64 * 1e-3;
        Self {
            count: histogram.len(),
            p50: us(0.5),
            p99: us(0.99),
            p999: us(0.999),
            max: histogram.max() as f64 * 1e-3,
        }
    }
}

impl std::fmt::Display for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            p50,
            p99,
            p999,
            max,
            ..
        } = self;
        write!(f, "{p50:>9.1} {p99:>9.1} {p999:>9.1} {max:>9.1}")
    }
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
