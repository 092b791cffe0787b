//! From sample due to forecast readable, between real processes, beside two raw iceoryx2 hops of the
//! same frames and the bare kernel: all three on one grid of time, a third of a period apart, so that
//! whatever disturbs the machine disturbs all of them.
//!
//! Coordinated omission: every figure that begins with "due" is counted from the place on the grid at
//! which the frame was *meant* to be sent. A place that a stalled source passed over is counted too,
//! up to the moment at which the next frame's answer could be read.

mod figures;
mod kernel;
pub mod raw;
pub mod through;

pub use figures::distribution;

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use hdrhistogram::Histogram;
use joulebus_bus::Scheduling;
use joulebus_predictor::{Model, Network};
use joulebus_predictor_worker::Spread;
use joulebus_program::verbs::bench::BenchOptions;
use joulebus_publisher::Pace;

use crate::{Report, threads};

/// Frames before the figures count.
pub const WARM_UP: u64 = 30;
/// What shares the grid: the way through the worker, the raw hops, the kernel.
const SHARES: u64 = 3;
/// How long the processes of a measurement may take to start.
const PATIENCE: Duration = Duration::from_secs(60);

/// Fleets measured by default.
const ROBOTS: [usize; 5] = [1, 20, 100, 1_000, 10_000];

/// How to start the running program so that it ends up in [`play`].
#[derive(Debug, Clone)]
pub struct Launcher {
    /// The program.
    pub program: PathBuf,
    /// What stands before the role's own arguments.
    pub arguments: Vec<String>,
}

impl Launcher {
    /// The running program with `arguments` before the role's own.
    ///
    /// # Errors
    /// The system does not tell which program runs.
    pub fn this(arguments: &[&str]) -> anyhow::Result<Self> {
        Ok(Self {
            program: std::env::current_exe().context("which program this is")?,
            arguments: arguments.iter().map(ToString::to_string).collect(),
        })
    }

    /// Starts the program in a role and waits until it says that it is ready.
    ///
    /// # Errors
    /// It cannot be started, or ends before it is ready.
    pub fn start(&self, role: &[String]) -> anyhow::Result<Child> {
        let mut child = Command::new(&self.program)
            .args(&self.arguments)
            .args(role)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| self.program.display().to_string())?;
        ready(&mut child)?;
        Ok(child)
    }
}

/// The processes of a measurement: the program that measures starts itself in these roles.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Role {
    /// The predictor-worker.
    Worker {
        /// The fleet's config.
        config: PathBuf,
    },
    /// A planner that measures.
    Planner {
        /// The fleet's config.
        config: PathBuf,
        /// From one frame to the next, ns.
        period_ns: u64,
    },
    /// Takes frames and sends forecasts of the same size on, computing nothing.
    Relay {
        /// Directory of its shared memory.
        root: PathBuf,
        /// Robots in a frame.
        robots: usize,
    },
    /// Takes what the relay sends, and measures.
    Sink {
        /// Directory of its shared memory.
        root: PathBuf,
        /// Robots in a frame.
        robots: usize,
        /// From one frame to the next, ns.
        period_ns: u64,
        /// Whether to print a byte for each frame.
        #[arg(long)]
        acknowledge: bool,
    },
}

/// Plays a role until the measurement is over; prints a line of JSON at the end.
///
/// # Errors
/// The role's process could not do its part.
pub fn play(role: &Role) -> anyhow::Result<()> {
    match role {
        Role::Worker { config } => through::worker(config),
        Role::Planner { config, period_ns } => through::planner(config, *period_ns),
        Role::Relay { root, robots } => raw::relay(root, *robots),
        Role::Sink {
            root,
            robots,
            period_ns,
            acknowledge,
        } => raw::sink(root, *robots, *period_ns, *acknowledge),
    }
}

/// Figures of one fleet size.
#[derive(Debug)]
struct Row {
    /// Robots in a frame.
    robots: usize,
    /// From the frame's intended time to the forecast readable.
    end_to_end_us: Spread,
    /// From the frame's sending to the forecast readable: the broker's share.
    sent_to_readable_us: Spread,
    /// From the frame's intended time to its sending: the source's own share.
    source_us: Spread,
    /// From the frame's sending to the worker's taking.
    one_way_us: Spread,
    /// From the tick's start to the last forecast written.
    compute_us: Spread,
    /// The whole tick, diagnostics and budgets included.
    tick_us: Spread,
    /// Two raw iceoryx2 hops of frames of the same sizes, from the intended time.
    raw_two_hops_us: Spread,
    /// The kernel alone after the same sleep.
    kernel_us: Spread,
    /// Median end to end over (median of two hops + median of the kernel).
    ratio_p50: f64,
    /// The same of the 99th percentiles.
    ratio_p99: f64,
    /// Memory of the worker that is its own, bytes.
    worker_bytes: u64,
    /// Ticks whose forecasts the planner did not see.
    missed: u64,
    /// Places on the grid that the source passed over: counted in the times, sent with the next.
    passed_over: u64,
}

/// Measures all sizes, each in turn; says on stderr what it is at. `launcher` starts this program in
/// a [`Role`].
///
/// # Errors
/// A process could not be started, or did not do its part.
pub(crate) fn measure(options: &BenchOptions, launcher: &Launcher) -> anyhow::Result<Report> {
    let (rate_hz, seconds) = (options.rate_hz, options.seconds_or(10));
    let scheduling = threads::scheduling(options);
    let model = model()?;
    let mut rows = Vec::new();
    for robots in options.sizes(&ROBOTS) {
        eprintln!("latency: {robots} robots, {seconds} s");
        rows.push(row(&model, robots, options, launcher)?);
    }
    let input = format!(
        "{rate_hz} frames a second for {seconds} s a size, built-in GTernal model, policy on_frame; \
         the way through the worker, two raw hops and the kernel take turns; times from the place \
         on the grid at which a frame was due, places passed over included; {}",
        asked_for(&scheduling)
    );
    Ok(figures::report(&input, &rows))
}

fn row(
    model: &Model,
    robots: usize,
    options: &BenchOptions,
    launcher: &Launcher,
) -> anyhow::Result<Row> {
    let frames = options.rate_hz * options.seconds_or(10);
    let period_ns = 1_000_000_000 / options.rate_hz;
    let scheduling = threads::scheduling(options);
    let mut through = through::Way::open(launcher, robots, period_ns, &scheduling)?;
    let mut raw = raw::Way::open(launcher, robots, period_ns, false)?;
    let mut kernel = kernel::Alone::new(model, robots);
    let mut pace = Pace::every(Duration::from_nanos(period_ns / SHARES));
    for frame in 0..WARM_UP + frames {
        through.send(pace.wait().intended_ns, frame)?;
        raw.send(pace.wait().intended_ns)?;
        pace.wait();
        kernel.run(frame >= WARM_UP);
    }
    let passed_over = pace.grid().skipped();
    let through = through.finish()?;
    let raw = raw.finish()?;
    let kernel = kernel.finish();
    Ok(Row {
        robots,
        ratio_p50: through.end_to_end_us.p50_us / (raw.p50_us + kernel.p50_us),
        ratio_p99: through.end_to_end_us.p99_us / (raw.p99_us + kernel.p99_us),
        end_to_end_us: through.end_to_end_us,
        sent_to_readable_us: through.sent_to_readable_us,
        source_us: through.source_us,
        one_way_us: through.one_way_us,
        compute_us: through.compute_us,
        tick_us: through.tick_us,
        raw_two_hops_us: raw,
        kernel_us: kernel,
        worker_bytes: through.worker_bytes,
        missed: through.missed,
        passed_over,
    })
}

fn asked_for(scheduling: &Scheduling) -> String {
    if scheduling.is_nothing() {
        return "the worker is an ordinary process".to_owned();
    }
    format!(
        "the worker has CPUs {:?}, SCHED_FIFO priority {}, memory {}",
        scheduling.cpus,
        scheduling.priority,
        if scheduling.lock_memory {
            "locked"
        } else {
            "unlocked"
        }
    )
}

fn model() -> anyhow::Result<Model> {
    let (_, bytes) = joulebus_config::builtin_model("gternal-sim").context("no built-in model")?;
    Ok(Model::Network(Network::from_safetensors(bytes)?))
}

/// The places on the grid that one answer stands for: `frames` that were sent, and those between the
/// first's intended time and its sending that a stalled source passed over. Records for each the
/// time up to `now_ns`.
pub fn record_places(
    times: &mut Histogram<u64>,
    (intended_ns, sent_ns, now_ns): (u64, u64, u64),
    period_ns: u64,
    frames: u64,
) {
    let passed_over = sent_ns.saturating_sub(intended_ns) / period_ns;
    for place in 0..frames.max(1 + passed_over) {
        times.saturating_record(now_ns.saturating_sub(intended_ns + place * period_ns));
    }
}

/// A child says that it is ready with a line.
fn ready(child: &mut Child) -> anyhow::Result<()> {
    use std::io::Read as _;
    let begin = std::time::Instant::now();
    let stdout = child
        .stdout
        .as_mut()
        .context("the child's output is not piped")?;
    let mut byte = [0];
    loop {
        stdout
            .read_exact(&mut byte)
            .context("a process of the measurement ended before it was ready")?;
        if byte[0] == b'\n' {
            return Ok(());
        }
        if begin.elapsed() > PATIENCE {
            bail!("a process of the measurement is not ready after {PATIENCE:?}");
        }
    }
}

/// Waits for a child's line of JSON, the last that it prints.
///
/// # Errors
/// It failed, or said something else.
pub fn finish<T: serde::de::DeserializeOwned>(child: Child) -> anyhow::Result<T> {
    let output = child.wait_with_output()?;
    if !output.status.success() {
        bail!("a process of the measurement ended with {}", output.status);
    }
    let last = output.stdout.trim_ascii().rsplit(|byte| *byte == b'\n');
    Ok(serde_json::from_slice(
        last.into_iter().next().unwrap_or_default(),
    )?)
}

#[cfg(test)]
mod tests {
    use super::record_places;
    use crate::histogram;

    #[test]
    fn places_that_a_stalled_source_passed_over_are_counted() {
        for (sent_ns, now_ns, frames, expected) in [
            (1_000, 1_050, 1, vec![50]),
            (1_040, 1_050, 1, vec![50]),
            // Due at 1,000, sent at 1,250: the places at 1,100 and 1,200 were passed over.
            (1_250, 1_260, 1, vec![60, 160, 260]),
            // Two frames answered at once.
            (1_000, 1_110, 2, vec![10, 110]),
        ] {
            let mut times = histogram();
            record_places(&mut times, (1_000, sent_ns, now_ns), 100, frames);
            let found: Vec<u64> = times
                .iter_recorded()
                .map(|value| value.value_iterated_to())
                .collect();
            assert_eq!(found, expected);
        }
    }
}
