//! `joulebus bench`.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::RangedU64ValueParser;

/// Benchmarks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Benchmark {
    /// The network alone: ns per robot by batch size, share of the processor's peak
    Kernel,
    /// The tick without shared memory: ns per robot, its stages, paced on one thread and two
    Tick,
    /// Many candidate command sequences, many steps ahead, in one call
    Rollout,
    /// Questions of a planner in its own process, beside the network's rollout
    Plan,
    /// Questions that the worker answers, and its ticks while clients ask as fast as they can
    Questions,
    /// From sample due to forecast readable, between separate processes
    Latency,
    /// All of them, one after the other
    All,
}

/// Measure the speed of this machine
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus bench kernel                                  ns per robot by batch size, share of the peak\n  \
    joulebus bench all --quick                             smoke test: runs, without usable figures\n  \
    joulebus bench kernel --json before.json               for tools/figures.py --compare\n\n\
    Times are p50, p99, p99.9 and max over all repetitions. Measurements are interleaved, so that \
    ratios hold on a busy machine. Absolute figures do not. Timings never decide the exit code. Build with --release.")]
pub(crate) struct BenchArguments {
    /// The benchmark
    #[arg(value_enum)]
    pub(crate) benchmark: Benchmark,
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    /// Write the figures to a file
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

#[derive(Debug, Clone, clap::Args)]
pub(crate) struct BenchOptions {
    /// Sizes: robots per batch or fleet, separated by commas [default: those of the benchmark]
    #[arg(long, value_name = "N,N,…", value_delimiter = ',',
        value_parser = RangedU64ValueParser::<usize>::new().range(1..=1_000_000))]
    pub(crate) robots: Vec<usize>,
    /// Time per measurement, s [default: 2 at most, and 10 for each size of a paced one]
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: Option<u64>,
    /// A few repetitions of a few sizes, as a smoke test
    #[arg(long)]
    pub(crate) quick: bool,
    /// Only this kernel, such as avx2 [default: all that the processor supports]
    #[arg(long, value_name = "NAME")]
    pub(crate) kernel: Option<String>,
    /// Tick: every robot's forecast learns online
    #[arg(long)]
    pub(crate) learning: bool,
}

impl BenchOptions {
    /// Sizes to measure: those requested, or the benchmark's own.
    pub(crate) fn sizes(&self, own: &[usize]) -> Vec<usize> {
        match (self.robots.is_empty(), self.quick) {
            (false, _) => self.robots.clone(),
            (true, true) => own.iter().copied().filter(|size| *size <= 1_000).collect(),
            (true, false) => own.to_vec(),
        }
    }

    /// Rounds, in each of which every measurement runs once.
    pub(crate) fn rounds(&self, usual: usize) -> usize {
        if self.quick { 5 } else { usual }
    }

    /// Maximum time per measurement.
    pub(crate) fn each(&self) -> Duration {
        match self.quick {
            true => Duration::from_millis(100),
            false => Duration::from_secs(self.seconds.unwrap_or(2)),
        }
    }

    /// Time for each size of a paced measurement, s.
    pub(crate) fn paced_s(&self, usual_s: u64) -> u64 {
        self.seconds.unwrap_or(if self.quick { 1 } else { usual_s })
    }
}
