//! `joulebus publish`.

use crate::exit::Outcome;
use crate::output::Output;

/// Publish samples
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_: &Args, _: Output) -> anyhow::Result<Outcome> {
    anyhow::bail!("`publish` is not part of this build yet")
}
