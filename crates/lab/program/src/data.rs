//! `joulebus data`: datasets.

mod check;
mod convert;
mod info;
mod simulate;

use clap::Subcommand;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;

/// Describe recorded trials, check them, convert them, and write simulated ones
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus data info recordings/*.csv.gz\n  \
    joulebus data check recordings/\n  \
    joulebus data convert trial1.npy --out trial1.csv.gz\n  \
    joulebus data simulate simulated")]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Info(info::Args),
    Check(check::Args),
    Convert(convert::Args),
    Simulate(simulate::Args),
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.verb {
        Verb::Info(args) => info::run(args, output),
        Verb::Check(args) => check::run(args, output),
        Verb::Convert(args) => convert::run(args, output),
        Verb::Simulate(args) => simulate::run(args, output),
    }
}
