//! Distributions of durations, as reports and live views show them.
//!
//! Pure: nothing here reads a clock.
//!
//! ```
//! use joulebus_latency::{Spread, histogram};
//!
//! let mut durations = histogram();
//! for ns in [10_000, 20_000, 30_000] {
//!     durations.record(ns)?;
//! }
//! let spread = Spread::new(&durations);
//! assert_eq!(spread.count, 3);
//! assert!((spread.p50_us - 20.0).abs() < 0.1);
//! # Ok::<(), hdrhistogram::RecordError>(())
//! ```
//!
//! **To know.** [`histogram`](histogram()) creates an [`hdrhistogram::Histogram`], which takes
//! durations from 1 ns to a minute with three significant digits. A [`Spread`] summarises it.
//!
//! **Units.** Durations go in as ns. A [`Spread`] has µs.
//!
//! **Errors.** Only recording can fail: a duration above a minute is refused by the histogram.
//!
//! **In the book**: [latency and transports][1], [metrics][2].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/measured/latency.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/metrics.md
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
