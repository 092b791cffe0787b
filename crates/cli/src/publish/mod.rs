//! `joulebus publish`: sources of samples.

mod fault;
mod sim;

use clap::Subcommand;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;

use crate::external;

/// Publish samples of a simulated fleet or of recorded trials, as a fleet controller would
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus publish sim --robots 20 --seed 7\n  \
    joulebus publish trial recordings/*.csv.gz --rate max")]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Sim(sim::Args),
    /// Play recorded trials as a fleet, one robot per file, then report
    Trial(external::Args),
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.verb {
        Verb::Sim(args) => sim::run(args, output),
        Verb::Trial(_) => external::run_lab("publish trial"),
    }
}
