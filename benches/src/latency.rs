//! Latency from sample due to forecast readable, between separate processes, compared with two raw
//! iceoryx2 hops of the same frames and with the bare kernel: all three on one time grid, a third
//! of a period apart, so that disturbances of the machine affect all of them.
//!
//! Coordinated omission: every figure that begins with "due" is measured from the grid time at
//! which the frame was *intended* to be sent. A grid time that a stalled source skipped is counted
//! too, up to the time at which the answer to the next frame was readable.

pub mod broker;
mod figures;
mod kernel;
pub mod raw;

use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::arguments::BenchOptions;
use anyhow::{Context, bail};
use hdrhistogram::Histogram;
use joulebus_latency::Spread;
use joulebus_predictor::Model;
use joulebus_program::stop::Stop;
use joulebus_publisher::Pace;

use crate::Report;
use crate::input::{self, RATE_HZ};

/// Frames before the measurement starts.
pub const WARM_UP: u64 = 30;
/// Measurements that share the grid: the broker, the raw hops, the kernel.
const SHARES: u64 = 3;
/// Timeout of starting the processes of a measurement.
const PATIENCE: Duration = Duration::from_secs(60);

/// Fleets measured by default.
const ROBOTS: [usize; 5] = [1, 20, 100, 1_000, 10_000];

/// Command that starts this program in a [`Role`].
#[derive(Debug, Clone)]
pub struct Launcher {
    pub program: PathBuf,
    /// Arguments before those of the role.
    pub arguments: Vec<String>,
}

impl Launcher {
    /// The running program with `arguments` before those of the role.
    ///
    /// # Errors
    /// The path of the running program is unknown.
    pub fn this(arguments: &[&str]) -> anyhow::Result<Self> {
        Ok(Self {
            program: std::env::current_exe().context("which program this is")?,
            arguments: arguments.iter().map(ToString::to_string).collect(),
        })
    }

    /// Starts the program in a role and waits until it reports that it is ready.
    ///
    /// # Errors
    /// The program cannot be started, or exits before it is ready.
    pub fn start(&self, role: &[String]) -> anyhow::Result<Child> {
        let mut child = Command::new(&self.program)
            .args(&self.arguments)
            .args(role)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // Signals of the terminal reach the benchmark alone, which ends its processes.
            .process_group(0)
            .spawn()
            .with_context(|| self.program.display().to_string())?;
        ready(&mut child)?;
        Ok(child)
    }
}

/// The processes of a measurement: the program starts itself in these roles.
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
        /// Period of the frames, ns.
        period_ns: u64,
    },
    /// Receives frames and sends forecasts of the same size, without computing.
    Relay {
        /// Directory of its shared memory.
        root: PathBuf,
        /// Robots per frame.
        robots: usize,
    },
    /// Receives from the relay, and measures.
    Sink {
        /// Directory of its shared memory.
        root: PathBuf,
        /// Robots per frame.
        robots: usize,
        /// Period of the frames, ns.
        period_ns: u64,
        /// Whether to print a byte for each frame.
        #[arg(long)]
        acknowledge: bool,
    },
}

/// Runs a role until the measurement ends. Prints a line of JSON at the end.
///
/// # Errors
/// The role's process failed.
pub fn play(role: &Role) -> anyhow::Result<()> {
    match role {
        Role::Worker { config } => broker::worker(config),
        Role::Planner { config, period_ns } => broker::planner(config, *period_ns),
        Role::Relay { root, robots } => raw::relay(root, *robots),
        Role::Sink { root, robots, period_ns, acknowledge } => {
            raw::sink(root, *robots, *period_ns, *acknowledge)
        }
    }
}

/// Figures of one fleet size.
#[derive(Debug)]
struct Row {
    robots: usize,
    broker: broker::Figures,
    /// Two raw iceoryx2 hops of frames of the same sizes, from the intended time.
    raw_two_hops_us: Spread,
    /// The kernel alone after the same sleep.
    kernel_us: Spread,
    /// Median end to end over (median of two hops + median of the kernel).
    ratio_p50: f64,
    /// The same of the 99th percentiles.
    ratio_p99: f64,
    /// Grid times that the source skipped: included in the latencies, sent with the next.
    passed_over: u64,
}

/// Measures all sizes, one after the other. Reports progress on stderr. `launcher` starts this
/// program in a [`Role`].
pub(crate) fn measure(options: &BenchOptions, launcher: &Launcher) -> anyhow::Result<Report> {
    let seconds = options.paced_s(10);
    let model = Model::Network(input::network()?);
    let stop = Stop::on_signals()?;
    let mut rows = Vec::new();
    for robots in options.sizes(&ROBOTS) {
        eprintln!("latency: {robots} robots, {seconds} s");
        rows.push(row(&model, robots, seconds, launcher, &stop)?);
    }
    let input = format!(
        "{RATE_HZ} frames a second for {seconds} s a size, built-in GTernal model, policy on_frame; \
         broker, two raw hops and the kernel are interleaved. Times are from the grid time \
         at which a frame was due, skipped ones included"
    );
    Ok(figures::report(&input, &rows))
}

fn row(
    model: &Model,
    robots: usize,
    seconds: u64,
    launcher: &Launcher,
    stop: &Stop,
) -> anyhow::Result<Row> {
    let frames = RATE_HZ * seconds;
    let period_ns = 1_000_000_000 / RATE_HZ;
    let mut broker = broker::Broker::open(launcher, robots, period_ns)?;
    let mut raw = raw::RawHops::open(launcher, robots, period_ns, false)?;
    let mut kernel = kernel::Alone::new(model, robots);
    let mut pace = Pace::every(Duration::from_nanos(period_ns / SHARES));
    for frame in 0..WARM_UP + frames {
        if stop.is_asked() {
            break;
        }
        broker.send(pace.wait().intended_ns, frame)?;
        raw.send(pace.wait().intended_ns)?;
        pace.wait();
        kernel.run(frame >= WARM_UP);
    }
    let passed_over = pace.grid().skipped();
    let (broker, raw) = (broker.finish(), raw.finish());
    anyhow::ensure!(!stop.is_asked(), "interrupted");
    let (broker, raw) = (broker?, raw?);
    let kernel = kernel.finish();
    Ok(Row {
        robots,
        ratio_p50: broker.end_to_end_us.p50_us / (raw.p50_us + kernel.p50_us),
        ratio_p99: broker.end_to_end_us.p99_us / (raw.p99_us + kernel.p99_us),
        broker,
        raw_two_hops_us: raw,
        kernel_us: kernel,
        passed_over,
    })
}

/// Records the latency at `now_ns` of every grid time covered by one answer: of the `frames` that
/// were sent, and of those between the first's intended time and its sending that a stalled source
/// skipped.
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

/// A child reports with a line that it is ready.
fn ready(child: &mut Child) -> anyhow::Result<()> {
    use std::io::Read as _;
    let begin = std::time::Instant::now();
    let stdout = child.stdout.as_mut().context("the child's output is not piped")?;
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

/// Reads a child's last line, JSON.
///
/// # Errors
/// The child failed, or printed something else.
pub fn finish<T: serde::de::DeserializeOwned>(child: Child) -> anyhow::Result<T> {
    let output = child.wait_with_output()?;
    if !output.status.success() {
        bail!("a process of the measurement ended with {}", output.status);
    }
    let last = output.stdout.trim_ascii().rsplit(|byte| *byte == b'\n');
    Ok(serde_json::from_slice(last.into_iter().next().unwrap_or_default())?)
}

#[cfg(test)]
mod tests {
    use super::record_places;
    use crate::histogram;

    #[test]
    fn grid_times_that_a_stalled_source_skipped_are_counted() {
        for (sent_ns, now_ns, frames, expected) in [
            (1_000, 1_050, 1, vec![50]),
            (1_040, 1_050, 1, vec![50]),
            // Due at 1,000, sent at 1,250: the grid times 1,100 and 1,200 were skipped.
            (1_250, 1_260, 1, vec![60, 160, 260]),
            // Two frames answered at once.
            (1_000, 1_110, 2, vec![10, 110]),
        ] {
            let mut times = histogram();
            record_places(&mut times, (1_000, sent_ns, now_ns), 100, frames);
            let found: Vec<u64> =
                times.iter_recorded().map(|value| value.value_iterated_to()).collect();
            assert_eq!(found, expected);
        }
    }
}
