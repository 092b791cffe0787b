//! From sample due to forecast readable, beside two raw iceoryx2 hops of the same frames and the bare
//! kernel, all in one run. The measurement is `joulebus_benches::latency`.
//!
//! `cargo bench -p joulebus-benches --bench latency -- --seconds 20 --json bench-results/latency.json`
#![forbid(unsafe_code)]

use std::process::ExitCode;

use joulebus_benches::{Benchmark, bench_target};

fn main() -> ExitCode {
    bench_target(Benchmark::Latency)
}
