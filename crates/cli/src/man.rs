//! `joulebus man`.

use std::path::PathBuf;

use anyhow::Context as _;
use joulebus_program::exit::Outcome;
use joulebus_program::file::write;

use crate::external;

/// Write the manual pages of all verbs into a folder
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus man ~/.local/share/man/man1\n  \
    joulebus man /tmp/pages && man /tmp/pages/joulebus-run.1\n\n\
    The pages say what --help says.")]
pub(crate) struct Args {
    /// The folder, which is created if it does not exist
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// Writes the manual pages of `program`.
pub(crate) fn run(args: &Args, program: clap::Command) -> anyhow::Result<Outcome> {
    let folder = args.folder.display();
    std::fs::create_dir_all(&args.folder).with_context(|| format!("cannot make {folder}"))?;
    let failed = || format!("cannot write the pages into {folder}");
    let made = tempfile::tempdir().with_context(failed)?;
    // A program of its own beside the verbs.
    for program in [program, external::lab()] {
        clap_mangen::generate_to(program, made.path()).with_context(failed)?;
    }
    // clap_mangen writes in place, through links and into pipes.
    for page in std::fs::read_dir(made.path()).with_context(failed)? {
        let page = page.with_context(failed)?;
        let text = std::fs::read(page.path()).with_context(failed)?;
        write(&args.folder.join(page.file_name()), &text)?;
    }
    Ok(Outcome::Done)
}
