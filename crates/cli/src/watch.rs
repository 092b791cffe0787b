//! `joulebus watch`.

use crate::exit::Outcome;
use crate::output::Output;

/// Show what the worker of a fleet forecasts
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_: &Args, _: Output) -> anyhow::Result<Outcome> {
    anyhow::bail!("`watch` is not part of this build yet")
}
