//! `joulebus bench`: how fast it is on this machine.

use joulebus_benches::latency::{self, Launcher, Role};
use joulebus_benches::{Benchmark, Command};

use crate::exit::Outcome;
use crate::output::Output;

/// Measure how fast this machine is, and compare with an earlier run
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus bench kernel                                  ns a robot by batch, share of the peak\n  \
    joulebus bench all --quick                             whether it runs, not how fast\n  \
    joulebus bench kernel --json before.json\n  \
    joulebus bench kernel --compare before.json            what became faster or slower since\n  \
    joulebus bench kernel --compare before.json --fail-above 1.1\n\n\
    Times are p50, p99, p99.9 and max over all repetitions; measurements take turns, so that \
    ratios hold on a busy machine while absolute figures do not. Nothing passes or fails by time: \
    exit 3 only with --fail-above. Build with --release.")]
pub(crate) struct Args {
    /// What is measured
    #[arg(value_enum)]
    benchmark: Benchmark,
    #[command(flatten)]
    command: Command,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    if cfg!(debug_assertions) {
        crate::output::say("warning: a dev build is measured; build with --release");
    }
    let launcher = Launcher::this(&["bench-role"])?;
    let ended = args.command.run(args.benchmark, &launcher)?;
    output.report(&ended)?;
    Ok(Outcome::unless_lost(!ended.worse.is_empty()))
}

/// The processes of the latency benchmark, which starts this program in these roles
#[derive(Debug, clap::Args)]
#[command(after_help = "Started by `joulebus bench latency`.")]
pub(crate) struct RoleArgs {
    #[command(subcommand)]
    role: Role,
}

pub(crate) fn play(args: &RoleArgs, _: Output) -> anyhow::Result<Outcome> {
    latency::play(&args.role)?;
    Ok(Outcome::Done)
}
