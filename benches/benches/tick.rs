//! The tick without shared memory: ns a robot, its stages, paced on one thread and several.
//!
//! `cargo bench -p joulebus-benches --bench tick -- --json bench-results/tick.json`
#![forbid(unsafe_code)]

use std::process::ExitCode;

use joulebus_benches::{Benchmark, bench_target};

fn main() -> ExitCode {
    bench_target(Benchmark::Tick)
}
