//! Benchmarks: `joulebus bench`, a separate program.
//!
//! Every figure has a name that ends in its unit, a case, and the distribution of its repetitions.
//! A [`Suite`] adds the machine, the build and the input, as text and as JSON.
//! `tools/figures.py` compares two.
#![allow(missing_docs)] // A program of its own.
#![forbid(unsafe_code)]

mod arguments;
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
mod tick;

pub use joulebus_latency::{Spread, histogram};

pub use report::{Report, Suite};
pub use run::main;
