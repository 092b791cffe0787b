//! `joulebus completions`.

use clap_complete::Shell;
use joulebus_program::exit::Outcome;
use joulebus_program::output;

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

/// Writes the completions of `program`.
pub(crate) fn run(args: &Args, mut program: clap::Command) -> anyhow::Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "joulebus", &mut script);
    output::text(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
}
