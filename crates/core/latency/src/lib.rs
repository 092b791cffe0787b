#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

/// A histogram of ns up to a minute, with three significant digits.
///
/// # Panics
/// Never: the bounds are constant and valid.
#[must_use]
#[allow(clippy::expect_used, reason = "the bounds are constants")]
pub fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3)
        .expect("1 ns to a minute with three digits is a valid range")
}

/// Distribution of a time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Values.
    pub count: u64,
    /// Minimum, µs.
    pub min_us: f64,
    /// First quartile, µs.
    pub p25_us: f64,
    /// Median, µs.
    pub p50_us: f64,
    /// Third quartile, µs.
    pub p75_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
    /// 99.9th percentile, µs.
    pub p999_us: f64,
    /// Maximum, µs.
    pub max_us: f64,
}

impl Spread {
    /// Summarises a histogram of ns.
    #[must_use]
    pub fn new(histogram: &Histogram<u64>) -> Self {
        let us = |quantile| histogram.value_at_quantile(quantile) as f64 * 1e-3;
        Self {
            count: histogram.len(),
            min_us: histogram.min() as f64 * 1e-3,
            p25_us: us(0.25),
            p50_us: us(0.5),
            p75_us: us(0.75),
            p99_us: us(0.99),
            p999_us: us(0.999),
            max_us: histogram.max() as f64 * 1e-3,
        }
    }
}
