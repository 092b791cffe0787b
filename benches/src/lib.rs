//! Measurements that a stranger can run: `joulebus bench` and `cargo bench -p joulebus-benches` call
//! the same functions.
//!
//! Every figure has a name that ends in its unit, a case, and the [`Distribution`] of its
//! repetitions. A [`Suite`] adds the machine, the build and the input, is written as text and as
//! JSON, and is [compared](Comparison) with an earlier one.
#![forbid(unsafe_code)]

mod command;
mod compare;
mod counted;
mod distribution;
mod figure;
mod input;
mod kernel;
pub mod latency;
mod machine;
mod options;
mod peak;
mod report;
mod rollout;
mod rounds;
mod threads;
mod tick;
pub mod wait;

mod world;

use hdrhistogram::Histogram;
pub use joulebus_predictor_worker::Spread;

pub use command::{Benchmark, Command, Ended, bench_target};
pub use compare::{Change, CompareError, Comparison, Verdict};
pub use counted::{Count, Counted, collected};
pub use distribution::Distribution;
pub use figure::{Better, Figure};
pub use machine::{Build, Machine};
pub use options::Options;
pub use report::{Report, SCHEMA, Suite};

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
