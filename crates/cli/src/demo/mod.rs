//! `joulebus demo`.

use crate::exit::Outcome;
use crate::output::Output;

/// Run a simulated fleet, a worker and a planner, and show what they do
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_: &Args, _: Output) -> anyhow::Result<Outcome> {
    anyhow::bail!("`demo` is not part of this build yet")
}
