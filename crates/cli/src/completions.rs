//! `joulebus completions`.

use clap::CommandFactory as _;
use clap_complete::Shell;

use crate::arguments::Cli;
use crate::exit::Outcome;
use crate::output::{self, Output};

/// Write completions for a shell
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus completions bash > ~/.local/share/bash-completion/completions/joulebus\n  \
    joulebus completions fish > ~/.config/fish/completions/joulebus.fish\n  \
    joulebus completions zsh > \"${fpath[1]}/_joulebus\"")]
pub(crate) struct Args {
    /// The shell
    shell: Shell,
}

pub(crate) fn run(args: &Args, _: Output) -> anyhow::Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "joulebus", &mut script);
    output::text(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
}
