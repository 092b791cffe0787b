//! `joulebus doctor`.

use crate::exit::Outcome;
use crate::output::Output;

/// Check this host and this fleet
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_: &Args, _: Output) -> anyhow::Result<Outcome> {
    anyhow::bail!("`doctor` is not part of this build yet")
}
