//! `joulebus-bench`: measures, and writes the figures.

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use crate::arguments::{BenchArguments, BenchOptions, Benchmark};
use anyhow::Context as _;
use clap::{Parser, ValueEnum as _};
use joulebus_program::exit::{self, Outcome};
use joulebus_program::output::{Output, log_line};
use joulebus_program::verb;

use crate::latency::{self, Launcher, Role};
use crate::{Report, Suite, kernel, plan, questions, rollout, tick};

/// First argument of the latency benchmark's child processes.
const ROLE: &str = "role";

/// The program: measures, or runs a role of the latency benchmark.
pub fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    let arguments = || std::env::args_os().skip(1);
    let first = arguments().next();
    match first.as_ref().and_then(|first| first.to_str()) {
        Some(ROLE) => exit::code(play(&RoleArguments::parse_from(arguments()))),
        _ => verb::main("bench", joulebus_bus::check_stack(), run),
    }
}

fn play(arguments: &RoleArguments) -> anyhow::Result<Outcome> {
    latency::play(&arguments.role)?;
    Ok(Outcome::Done)
}

/// The processes of the latency benchmark, which starts this program in these roles
#[derive(Debug, Parser)]
struct RoleArguments {
    #[command(subcommand)]
    role: Role,
}

fn run(arguments: &BenchArguments, output: Output) -> anyhow::Result<Outcome> {
    if cfg!(debug_assertions) {
        log_line("warning: this is a dev build. Build with --release");
    }
    let suite = Suite::here(measure(arguments.benchmark, &arguments.options)?);
    if let Some(path) = &arguments.json {
        write(path, &suite)?;
    }
    output.report(&suite)?;
    Ok(Outcome::Done)
}

fn measure(benchmark: Benchmark, options: &BenchOptions) -> anyhow::Result<Vec<Report>> {
    let launcher = Launcher::this(&[ROLE])?;
    let report = match benchmark {
        Benchmark::Kernel => kernel::measure(options)?,
        Benchmark::Tick => tick::measure(options)?,
        Benchmark::Rollout => rollout::measure(options)?,
        Benchmark::Plan => plan::measure(options)?,
        Benchmark::Questions => questions::measure(options, &launcher)?,
        Benchmark::Latency => latency::measure(options, &launcher)?,
        Benchmark::All => {
            let each = Benchmark::value_variants().iter().filter(|each| **each != Benchmark::All);
            let reports = each.map(|each| measure(*each, options));
            let reports: anyhow::Result<Vec<_>> = reports.collect();
            return Ok(reports?.into_iter().flatten().collect());
        }
    };
    Ok(vec![report])
}

fn write(path: &Path, suite: &Suite) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(suite)? + "\n";
    path.parent()
        .map_or(Ok(()), fs::create_dir_all)
        .with_context(|| format!("cannot write {}", path.display()))?;
    joulebus_program::file::write(path, json.as_bytes())
}
