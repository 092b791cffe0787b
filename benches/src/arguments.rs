//! `joulebus bench`.

use std::path::PathBuf;
use std::time::Duration;

/// Benchmarks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Benchmark {
    /// The network alone: ns per robot by batch size, share of the processor's peak
    Kernel,
    /// The tick without shared memory: ns per robot, its stages, paced on one thread and several
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

/// The fleet of the tick benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum TickFleet {
    /// One platform, whose every sample has a reading
    Uniform,
    /// Three platforms, whose robots alternate
    Mixed,
    /// One sample in ten has no reading
    MissingReadings,
    /// Every robot's forecast learns online, unlike in the other fleets
    Learning,
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
    /// Its options.
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    /// Write the figures to a file
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

#[derive(Debug, Clone, clap::Args)]
pub(crate) struct BenchOptions {
    /// Sizes: robots per batch or fleet, separated by commas [default: those of the benchmark]
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', value_parser = size)]
    pub(crate) robots: Vec<usize>,
    /// Rounds, in each of which every measurement runs once [default: 1000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) repetitions: Option<u32>,
    /// Time per measurement, s [default: 2 at most, and 10 for each size of a paced one]
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub(crate) seconds: Option<u64>,
    /// Frames per second of a paced measurement
    #[arg(long, value_name = "HZ", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub(crate) rate_hz: u64,
    /// A few repetitions of a few sizes, as a smoke test
    #[arg(long)]
    pub(crate) quick: bool,
    /// Seed of the inputs
    #[arg(long, value_name = "N", default_value_t = 7)]
    pub(crate) seed: u64,
    /// A model file [default: the built-in one]
    #[arg(long, value_name = "FILE")]
    pub(crate) model: Option<PathBuf>,
    /// Only this kernel, such as avx2 [default: all that the processor supports]
    #[arg(long, value_name = "NAME")]
    pub(crate) kernel: Option<String>,
    /// Latency: CPUs of the worker's tick thread
    #[arg(long, value_name = "CPU,…", value_delimiter = ',')]
    pub(crate) worker_cpus: Vec<usize>,
    /// Latency: real-time priority of that thread, 0 for none
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=99))]
    pub(crate) worker_priority: u8,
    /// Latency: lock the worker's memory
    #[arg(long)]
    pub(crate) worker_locked: bool,
    /// Tick: the fleet
    #[arg(long, value_enum, default_value_t = TickFleet::Uniform)]
    pub(crate) fleet: TickFleet,
    /// Threads for large batches, in addition to one
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = threads)]
    pub(crate) threads: usize,
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
    pub(crate) fn repetitions(&self) -> usize {
        self.repetitions_or(1000)
    }

    /// The same with another default.
    pub(crate) fn repetitions_or(&self, default: usize) -> usize {
        let default = if self.quick { 5 } else { default };
        self.repetitions.map_or(default, |count| count as usize)
    }

    /// Maximum time per measurement.
    pub(crate) fn each(&self) -> Duration {
        if self.quick {
            Duration::from_millis(100)
        } else {
            Duration::from_secs(self.seconds.unwrap_or(2))
        }
    }

    /// Time for each size of a paced measurement, s.
    pub(crate) fn seconds_or(&self, default_s: u64) -> u64 {
        let default_s = if self.quick { 1 } else { default_s };
        self.seconds.unwrap_or(default_s)
    }
}

fn size(text: &str) -> Result<usize, String> {
    within(text, 1, 1_000_000)
}

fn threads(text: &str) -> Result<usize, String> {
    within(text, 1, 64)
}

fn within(text: &str, least: usize, most: usize) -> Result<usize, String> {
    let count = text.parse().ok();
    let allowed = count.filter(|count| (least..=most).contains(count));
    allowed.ok_or_else(|| format!("allowed are {least} to {most}"))
}
