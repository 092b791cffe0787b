//! The same frames over joulebus, raw iceoryx2 and Unix sockets, in one run: each from a source to a
//! sink, through a relay process that answers a frame of samples with a frame of forecasts.
//!
//! ```text
//! cargo run --release --manifest-path tools/peers/transport/Cargo.toml -- \
//!     --json bench-results/transport.json
//! ```
#![forbid(unsafe_code)]

mod frame;
mod sink;
mod unix;
mod way;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::{Parser, Subcommand};
use joulebus_bench::latency::{self, Launcher, WARM_UP, broker, raw};
use joulebus_bench::{Report, Suite};
use joulebus_bus::clock;
use joulebus_publisher::Pace;

use crate::frame::{forecast_bytes, sample_bytes};
use crate::sink::Sink;
use crate::unix::Unix;
use crate::way::{Joulebus, Way};

/// Frames in flight when frames are sent as fast as possible.
const WINDOW: usize = 2;

/// The same frames over joulebus and other transports
#[derive(Debug, Parser)]
struct Arguments {
    /// Robots per frame, several sizes
    #[arg(long, value_delimiter = ',', default_value = "1,100,1000,10000")]
    robots: Vec<usize>,
    /// Time for each size, paced, s
    #[arg(long, default_value_t = 15)]
    seconds: u64,
    /// Time for each size and transport, as fast as possible, s
    #[arg(long, default_value_t = 2)]
    flat_out_seconds: u64,
    /// Frames per second, paced
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=250))]
    rate_hz: u64,
    /// Where to write the figures as JSON
    #[arg(long)]
    json: Option<PathBuf>,
    #[command(subcommand)]
    role: Option<Role>,
}

/// The processes of a measurement.
#[derive(Debug, Clone, Subcommand)]
enum Role {
    #[command(flatten)]
    Joulebus(latency::Role),
    /// The relay, Unix sockets.
    #[command(hide = true)]
    UnixRelay { directory: PathBuf, robots: usize },
    /// The sink, Unix sockets.
    #[command(hide = true)]
    UnixSink(End),
}

/// Arguments of a sink.
#[derive(Debug, Clone, clap::Args)]
struct End {
    directory: PathBuf,
    robots: usize,
    period_ns: u64,
    #[arg(long)]
    acknowledge: bool,
}

impl End {
    fn sink(&self) -> Sink {
        Sink::new(self.robots, self.period_ns, self.acknowledge)
    }
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    match &arguments.role {
        None => measure(&arguments),
        Some(Role::Joulebus(role)) => latency::play(role),
        Some(Role::UnixRelay { directory, robots }) => unix::relay(directory, *robots),
        Some(Role::UnixSink(end)) => unix::sink(&end.directory, end.sink(), end.robots),
    }
}

fn measure(arguments: &Arguments) -> anyhow::Result<()> {
    let launcher = Launcher::this(&[])?;
    let mut paced = report(arguments, "transport, paced")
        .with_input("rate", format!("{} frames a second", arguments.rate_hz))
        .with_input("time", format!("{} s a size", arguments.seconds));
    let mut flat_out = report(arguments, "transport, as fast as possible")
        .with_input("window", format!("{WINDOW} frames in flight"))
        .with_input("time", format!("{} s each", arguments.flat_out_seconds));
    for robots in &arguments.robots {
        eprintln!("{robots} robots, paced");
        pace(arguments, &launcher, *robots, &mut paced)?;
        eprintln!("{robots} robots, as fast as possible");
        flood(arguments, &launcher, *robots, &mut flat_out)?;
    }
    paced.notes = [
        "From the time at which a frame was due at the source to its answer readable at the sink; \
         grid times that a stalled source skipped are counted.",
        "All transports are interleaved on one grid. Each has a relay process; only joulebus' computes \
         anything there.",
    ]
    .map(str::to_owned)
    .to_vec();
    flat_out.notes = vec![
        "Answered frames per second, two in flight. joulebus is not among them: its worker ticks at \
         its rate, not at the rate of the frames."
            .to_owned(),
    ];
    let suite = Suite::here(vec![paced, flat_out]);
    print!("{suite}");
    if let Some(path) = &arguments.json {
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent)?;
        }
        std::fs::write(path, serde_json::to_string_pretty(&suite)? + "\n")
            .with_context(|| path.display().to_string())?;
    }
    Ok(())
}

fn report(arguments: &Arguments, name: &str) -> Report {
    let sizes = arguments.robots.iter().map(|robots| {
        let (there, back) = (sample_bytes(*robots), forecast_bytes(*robots));
        format!("{robots} robots: {there} and {back} bytes")
    });
    Report::new(name)
        .with_input("frames", sizes.collect::<Vec<_>>().join(", "))
        .with_input("versions", "iceoryx2 0.10.0")
}

/// All transports on one grid, a share of the period apart.
fn pace(
    arguments: &Arguments,
    launcher: &Launcher,
    robots: usize,
    report: &mut Report,
) -> anyhow::Result<()> {
    let period_ns = 1_000_000_000 / arguments.rate_hz;
    let broker = broker::Broker::open(launcher, robots, period_ns)?;
    let joulebus = Joulebus { way: broker, frames: 0 };
    let mut ways: Vec<(&str, Box<dyn Way>)> = vec![("joulebus_us", Box::new(joulebus))];
    for (name, open) in others() {
        ways.push((name, open(launcher, robots, period_ns, false)?));
    }
    let mut pace = Pace::every(Duration::from_nanos(period_ns / ways.len() as u64));
    for _ in 0..WARM_UP + arguments.rate_hz * arguments.seconds {
        for (_, way) in &mut ways {
            way.send(pace.wait().intended_ns)?;
        }
    }
    for (name, way) in ways {
        report.times(name, &case(robots), &way.finish()?);
    }
    Ok(())
}

/// One transport after the other, each frame as soon as an earlier one has been answered.
fn flood(
    arguments: &Arguments,
    launcher: &Launcher,
    robots: usize,
    report: &mut Report,
) -> anyhow::Result<()> {
    for (name, open) in others() {
        let mut way = open(launcher, robots, 1_000_000, true)?;
        let time = Duration::from_secs(arguments.flat_out_seconds);
        (0..WINDOW).try_for_each(|_| way.send(clock::monotonic_ns()))?;
        let (begin, mut answered) = (Instant::now(), 0);
        while begin.elapsed() < time {
            way.acknowledged()?;
            answered += 1;
            way.send(clock::monotonic_ns())?;
        }
        let rate = f64::from(answered) / begin.elapsed().as_secs_f64();
        way.finish()?;
        let name = name.replace("_us", "_frames_per_s");
        report.more(&name, &case(robots), "frames/s", &[rate]);
    }
    Ok(())
}

type Open = fn(&Launcher, usize, u64, bool) -> anyhow::Result<Box<dyn Way>>;

/// The transports that can also be driven as fast as possible.
fn others() -> [(&'static str, Open); 2] {
    [
        ("iceoryx2_us", |launcher, robots, period_ns, acknowledge| {
            Ok(Box::new(raw::RawHops::open(launcher, robots, period_ns, acknowledge)?))
        }),
        ("unix_stream_us", |launcher, robots, period_ns, acknowledge| {
            Ok(Box::new(Unix::open(launcher, robots, period_ns, acknowledge)?))
        }),
    ]
}

fn case(robots: usize) -> String {
    format!("{robots} robots")
}
