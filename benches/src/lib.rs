//! Benchmarks: `joulebus bench`, a separate program.
//!
//! Every figure has a name that ends in its unit, a case, and the [`Distribution`] of its
//! repetitions. A [`Suite`] adds the machine, the build and the input, is written as text and as
//! JSON, and can be [compared](Comparison) with an earlier one.
#![forbid(unsafe_code)]

mod arguments;
mod callgrind;
mod compare;
mod counted;
mod distribution;
mod figure;
mod input;
mod kernel;
pub mod latency;
mod machine;
mod peak;
mod plan;
mod questions;
mod report;
mod rollout;
mod rounds;
mod run;
mod threads;
mod tick;
mod wait;
mod world;

use hdrhistogram::Histogram;
pub use joulebus_predictor_worker::Spread;

pub use compare::{Change, CompareError, Comparison, Verdict};
pub use distribution::Distribution;
pub use figure::{Better, Figure};
pub use machine::{Build, Machine};
pub use report::{Report, SCHEMA, Suite};
pub use run::main;

/// A histogram of ns up to a minute, with three significant digits.
///
/// # Panics
/// Never: the bounds are constant and valid.
#[must_use]
pub fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3)
        .expect("1 ns to 1 min in three digits is valid")
}

#[cfg(test)]
mod tests {
    use clap::Args as _;

    use crate::arguments::BenchArguments;

    #[test]
    fn the_main_program_shows_these_options() {
        let verb = BenchArguments::augment_args(clap::Command::new("bench"));
        joulebus_program::described::check("bench", &[verb]);
    }
}
