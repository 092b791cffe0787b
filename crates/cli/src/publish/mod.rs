//! `joulebus publish`: sources of samples.

mod fault;
pub(crate) mod flow;
mod link;
mod report;
mod sim;
mod trial;

pub(crate) use trial::{Passes, Rate};
pub(crate) mod window;

use std::str::FromStr;
use std::time::Duration;

use clap::Subcommand;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;

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
    Trial(trial::Args),
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.verb {
        Verb::Sim(args) => sim::run(args, output),
        Verb::Trial(args) => trial::run(args, output),
    }
}

/// A rate on the command line, Hz: 0.1 to 1000.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hertz(f64);

impl Hertz {
    /// Time between two frames, ns.
    fn period_ns(self) -> u64 {
        // The range is checked at construction.
        (1e9 / self.0).round() as u64
    }
}

impl FromStr for Hertz {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        number(text, 0.1, 1000.0, "Hz").map(Self)
    }
}

/// A number within a range, both ends included.
pub(crate) fn number(text: &str, least: f64, greatest: f64, unit: &str) -> Result<f64, String> {
    let value: f64 = text
        .parse()
        .map_err(|_| format!("{text:?} is not a number ({unit})"))?;
    if least <= value && value <= greatest {
        Ok(value)
    } else {
        Err(format!(
            "{value} {unit}: allowed are {least} to {greatest} {unit}"
        ))
    }
}

/// A time on the command line, s.
pub(crate) fn seconds(text: &str) -> Result<Duration, String> {
    number(text, 0.001, 1e8, "s").map(Duration::from_secs_f64)
}
