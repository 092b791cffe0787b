//! ns a robot of each kernel, by batch, and its share of what the processor can do.
//!
//! `cargo bench -p joulebus-benches --bench kernel -- --json bench-results/kernel.json`
#![forbid(unsafe_code)]

use std::process::ExitCode;

use joulebus_benches::{Benchmark, bench_target};

fn main() -> ExitCode {
    bench_target(Benchmark::Kernel)
}
