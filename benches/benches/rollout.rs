//! Many candidate command sequences, many steps ahead, in one call, beside the bare kernel.
//!
//! `cargo bench -p joulebus-benches --bench rollout -- --json bench-results/rollout.json`
#![forbid(unsafe_code)]

use std::process::ExitCode;

use joulebus_benches::{Benchmark, bench_target};

fn main() -> ExitCode {
    bench_target(Benchmark::Rollout)
}
