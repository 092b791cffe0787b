//! Figures that tests print, and reproducible random numbers.

use std::fmt;
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Prints a figure on a separate line.
pub fn figure(name: &str, value: impl fmt::Display) {
    println!("figure: {name}: {value}");
}

/// Distribution of a duration.
#[derive(Debug, Clone, Default)]
pub struct Spread {
    values: Vec<Duration>,
}

impl Spread {
    pub fn add(&mut self, value: Duration) {
        self.values.push(value);
    }

    /// Adds a value, ns.
    pub fn add_ns(&mut self, value_ns: u64) {
        self.add(Duration::from_nanos(value_ns));
    }

    pub const fn count(&self) -> usize {
        self.values.len()
    }

    fn ms(&self, share: f64) -> f64 {
        let mut sorted = self.values.clone();
        sorted.sort_unstable();
        let at = (share * sorted.len() as f64).ceil() as usize;
        let value = sorted.get(at.max(1) - 1).copied().unwrap_or_default();
        value.as_secs_f64() * 1e3
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (p50, p99, max) = (self.ms(0.5), self.ms(0.99), self.ms(1.0));
        let count = self.count();
        write!(out, "p50 {p50:.2} ms, p99 {p99:.2} ms, max {max:.2} ms (n = {count})")
    }
}

/// Seeded random numbers; the seed is printed. `JOULEBUS_SEED` sets another one.
#[derive(Debug)]
pub struct Dice(Pcg64Mcg);

impl Dice {
    /// Reads the seed and prints it.
    pub fn roll() -> Self {
        let seed = count("JOULEBUS_SEED", 2);
        println!("seed: {seed}");
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    /// A random integer below `end`.
    pub fn below(&mut self, end: u64) -> u64 {
        self.0.random_range(0..end)
    }

    /// A random duration below `end`.
    pub fn time_below(&mut self, end: Duration) -> Duration {
        Duration::from_nanos(self.below(end.as_nanos() as u64))
    }

    /// True with probability `share`, 0 to 1.
    pub fn chance(&mut self, share: f64) -> bool {
        self.0.random_bool(share)
    }

    /// Number of repetitions: from the environment variable `name`, or `default`.
    pub fn rounds(name: &str, default: u64) -> u64 {
        count(name, default)
    }
}

fn count(name: &str, default: u64) -> u64 {
    match std::env::var(name) {
        Ok(text) => {
            text.parse().unwrap_or_else(|_| panic!("{name} is {text:?}; an integer is required"))
        }
        Err(_) => default,
    }
}
