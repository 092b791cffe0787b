//! `joulebus man`.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::CommandFactory as _;
use joulebus_program::exit::Outcome;
use joulebus_program::verbs::rosbag::RosbagArguments;

/// Write the manual pages of all verbs into a folder
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus man ~/.local/share/man/man1\n  \
    joulebus man /tmp/pages && man /tmp/pages/joulebus-run.1\n\n\
    The pages say what --help says.")]
pub(crate) struct Args {
    /// The folder; it is made if it is not there
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// Writes those of `program`.
pub(crate) fn run(args: &Args, program: clap::Command) -> anyhow::Result<Outcome> {
    let folder = args.folder.display();
    std::fs::create_dir_all(&args.folder).with_context(|| format!("cannot make {folder}"))?;
    // No verb, but a program of its own.
    let rosbag = RosbagArguments::command();
    for program in [program, rosbag] {
        clap_mangen::generate_to(program, &args.folder)
            .with_context(|| format!("cannot write the pages into {folder}"))?;
    }
    Ok(Outcome::Done)
}
