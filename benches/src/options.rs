//! What a benchmark is told: the same options for `joulebus bench` and for `cargo bench`.

use std::path::PathBuf;
use std::time::Duration;

use joulebus_bus::Scheduling;

/// What and how much is measured.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// Sizes: robots of a batch or a fleet, separated by commas [default: as the benchmark has them]
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', value_parser = size)]
    pub robots: Vec<usize>,
    /// Rounds in which all measurements take turns [default: 1000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub repetitions: Option<u32>,
    /// Time for each measurement, s [default: 2 at most, and 10 for each size of a paced one]
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub seconds: Option<u64>,
    /// Frames a second of a paced measurement
    #[arg(long, value_name = "HZ", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub rate_hz: u64,
    /// A few repetitions of a few sizes: whether it runs, not how fast
    #[arg(long)]
    pub quick: bool,
    /// Seed of the inputs
    #[arg(long, value_name = "N", default_value_t = 7)]
    pub seed: u64,
    /// A model file [default: the one that ships]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Only this kernel, like avx2 [default: all that the processor has]
    #[arg(long, value_name = "NAME")]
    pub kernel: Option<String>,
    /// Latency: CPUs that the worker's tick stays on
    #[arg(long, value_name = "CPU,…", value_delimiter = ',')]
    pub worker_cpus: Vec<usize>,
    /// Latency: real-time priority of the worker's tick; 0: none
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=99))]
    pub worker_priority: u8,
    /// Latency: the worker's memory stays in memory
    #[arg(long)]
    pub worker_locked: bool,
    /// Threads that share large batches, beside one
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = threads)]
    pub threads: usize,
}

impl Options {
    /// What the worker of the latency benchmark asks of the system, and must get.
    #[must_use]
    pub fn scheduling(&self) -> Scheduling {
        Scheduling {
            cpus: self.worker_cpus.clone(),
            priority: self.worker_priority,
            lock_memory: self.worker_locked,
            required: true,
        }
    }

    /// Sizes to measure: those asked for, or the benchmark's own.
    #[must_use]
    pub fn sizes(&self, own: &[usize]) -> Vec<usize> {
        match (self.robots.is_empty(), self.quick) {
            (false, _) => self.robots.clone(),
            (true, true) => own.iter().copied().filter(|size| *size <= 1_000).collect(),
            (true, false) => own.to_vec(),
        }
    }

    /// Rounds in which all measurements take turns.
    #[must_use]
    pub fn repetitions(&self) -> usize {
        let default = if self.quick { 5 } else { 1000 };
        self.repetitions.map_or(default, |count| count as usize)
    }

    /// Time for each measurement at most.
    #[must_use]
    pub fn each(&self) -> Duration {
        if self.quick {
            Duration::from_millis(100)
        } else {
            Duration::from_secs(self.seconds.unwrap_or(2))
        }
    }

    /// Time for each size of a paced measurement, s.
    #[must_use]
    pub fn seconds_or(&self, default_s: u64) -> u64 {
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
