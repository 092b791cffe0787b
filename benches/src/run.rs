//! `joulebus-bench`: measures, and writes the figures.

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use crate::arguments::{BenchArguments, BenchOptions, Benchmark};
use anyhow::Context as _;
use clap::Parser;
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
    Ok(match benchmark {
        Benchmark::Kernel => vec![kernel::measure(options)?],
        Benchmark::Tick => vec![tick::measure(options)?],
        Benchmark::Rollout => vec![rollout::measure(options)?],
        Benchmark::Plan => vec![plan::measure(options)?],
        Benchmark::Questions => vec![questions::measure(options, &Launcher::this(&[ROLE])?)?],
        Benchmark::Latency => vec![latency::measure(options, &Launcher::this(&[ROLE])?)?],
        Benchmark::All => {
            let each = [
                Benchmark::Kernel,
                Benchmark::Tick,
                Benchmark::Rollout,
                Benchmark::Plan,
                Benchmark::Questions,
                Benchmark::Latency,
            ];
            let reports = each.map(|benchmark| measure(benchmark, options));
            let reports: anyhow::Result<Vec<_>> = reports.into_iter().collect();
            reports?.concat()
        }
    })
}

fn write(path: &Path, suite: &Suite) -> anyhow::Result<()> {
    let shown = path.display();
    let json = serde_json::to_string_pretty(suite)? + "\n";
    path.parent()
        .map_or(Ok(()), fs::create_dir_all)
        .with_context(|| format!("cannot write {shown}"))?;
    joulebus_program::file::write(path, json.as_bytes())
}
