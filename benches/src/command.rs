//! A benchmark as a command: `joulebus bench` and the targets of `cargo bench`.

use std::fmt;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use clap::{Parser, ValueEnum};
use serde::Serialize;

use crate::latency::{self, Launcher, Role};
use crate::{Comparison, Options, Report, Suite, kernel, rollout, tick};

/// Exit code of figures that are worse than allowed.
const WORSE: u8 = 3;

/// What can be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Benchmark {
    /// The network alone: ns a robot by batch, share of the processor's peak
    Kernel,
    /// The tick without shared memory: ns a robot, its stages, paced on one thread and several
    Tick,
    /// Many candidate command sequences, many steps ahead, in one call
    Rollout,
    /// From sample due to forecast readable, between real processes
    Latency,
    /// Everything, one after the other
    All,
}

/// How a measurement is run and what becomes of its figures.
#[derive(Debug, Clone, clap::Args)]
pub struct Command {
    #[command(flatten)]
    options: Options,
    /// Write the figures to a file, for --compare
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Compare with the figures of an earlier run
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    /// With --compare: exit 3 if a figure is so many times worse, beyond noise
    #[arg(long, value_name = "RATIO", requires = "compare", value_parser = ratio)]
    fail_above: Option<f64>,
}

/// A measurement that was run.
#[derive(Debug, Serialize)]
pub struct Ended {
    /// The figures.
    #[serde(flatten)]
    pub suite: Suite,
    /// Beside an earlier run, if that was asked for.
    pub comparison: Option<Comparison>,
    /// Figures that are worse than `--fail-above` allows.
    pub worse: Vec<String>,
}

impl Command {
    /// Measures, writes the file, compares. `launcher` starts this program in a [`Role`].
    ///
    /// # Errors
    /// Something could not be measured, read or written.
    pub fn run(&self, benchmark: Benchmark, launcher: &Launcher) -> anyhow::Result<Ended> {
        // Before minutes of measuring, not after.
        let old = self.compare.as_deref().map(read).transpose()?;
        let suite = Suite::here(measure(benchmark, &self.options, launcher)?);
        if let Some(path) = &self.json {
            write(path, &suite)?;
        }
        let comparison = old.map(|old| Comparison::new(&old, &suite)).transpose()?;
        let worse = comparison.iter().flat_map(|comparison| {
            let allowed = self.fail_above.unwrap_or(f64::INFINITY);
            comparison.worse_than(allowed)
        });
        let said = worse.map(|change| {
            let times = change.times_worse;
            format!(
                "{} {}, {}: {times:.3} times worse",
                change.benchmark, change.name, change.case
            )
        });
        let worse = said.collect();
        Ok(Ended {
            suite,
            comparison,
            worse,
        })
    }
}

fn measure(
    benchmark: Benchmark,
    options: &Options,
    launcher: &Launcher,
) -> anyhow::Result<Vec<Report>> {
    let of = |benchmark| match benchmark {
        Benchmark::Kernel => kernel::measure(options),
        Benchmark::Tick => tick::measure(options),
        Benchmark::Rollout => rollout::measure(options),
        Benchmark::Latency | Benchmark::All => {
            let report = latency::run(&latency::Options {
                robots: options.sizes(&latency::ROBOTS),
                seconds: options.seconds_or(10),
                rate_hz: options.rate_hz,
                scheduling: options.scheduling(),
                launcher: launcher.clone(),
            })?;
            Ok(report.figures())
        }
    };
    match benchmark {
        Benchmark::All => [
            Benchmark::Kernel,
            Benchmark::Tick,
            Benchmark::Rollout,
            Benchmark::Latency,
        ]
        .into_iter()
        .map(of)
        .collect(),
        one => Ok(vec![of(one)?]),
    }
}

fn read(path: &Path) -> anyhow::Result<Suite> {
    let shown = path.display();
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {shown}"))?;
    serde_json::from_str(&text)
        .with_context(|| format!("{shown} has no figures: write it with --json"))
}

fn write(path: &Path, suite: &Suite) -> anyhow::Result<()> {
    let shown = path.display();
    let json = serde_json::to_string_pretty(suite)? + "\n";
    path.parent()
        .map_or(Ok(()), fs::create_dir_all)
        .and_then(|()| fs::write(path, json))
        .with_context(|| format!("cannot write {shown}"))
}

fn ratio(text: &str) -> Result<f64, String> {
    let ratio = text.parse().ok();
    let allowed = ratio.filter(|ratio: &f64| *ratio >= 1.0 && ratio.is_finite());
    allowed.ok_or_else(|| "allowed are numbers from 1, like 1.1".to_owned())
}

impl fmt::Display for Ended {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.suite)?;
        if let Some(comparison) = &self.comparison {
            write!(out, "\n{comparison}")?;
        }
        for worse in &self.worse {
            writeln!(out, "too slow: {worse}")?;
        }
        Ok(())
    }
}

/// The arguments of a target of `cargo bench`.
#[derive(Debug, Parser)]
struct Target {
    #[command(flatten)]
    command: Command,
    /// Write the figures to stdout as JSON
    #[arg(long)]
    as_json: bool,
    /// Given by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
    #[command(subcommand)]
    role: Option<Role>,
}

/// Runs a target of `cargo bench` with the arguments of this process; a role of the latency
/// benchmark, if it was started as one.
#[must_use]
pub fn bench_target(benchmark: Benchmark) -> ExitCode {
    let target = Target::parse();
    match run_target(benchmark, &target) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run_target(benchmark: Benchmark, target: &Target) -> anyhow::Result<ExitCode> {
    if let Some(role) = &target.role {
        latency::play(role)?;
        return Ok(ExitCode::SUCCESS);
    }
    let ended = target.command.run(benchmark, &Launcher::this(&[])?)?;
    let text = if target.as_json {
        serde_json::to_string_pretty(&ended)?
    } else {
        ended.to_string()
    };
    writeln!(io::stdout(), "{text}")?;
    Ok(if ended.worse.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(WORSE)
    })
}
