//! `joulebus man`.

use std::path::PathBuf;

use anyhow::Context as _;
use joulebus_files::WholeFolder;
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
    let failed = || format!("cannot write the pages into {}", args.folder.display());
    let mut whole = WholeFolder::begin(&args.folder).with_context(failed)?;
    // A program of its own beside the verbs.
    for program in [program, external::lab()] {
        let mut program = program.disable_help_subcommand(true);
        program.build();
        let mut pages = Vec::new();
        add_pages(&program, &mut pages).with_context(failed)?;
        for (name, text) in pages {
            write(&whole.path(name).with_context(failed)?, &text)?;
        }
    }
    whole.keep().with_context(failed)?;
    Ok(Outcome::Done)
}

/// Adds the names and texts of the pages of a program and its verbs. clap_mangen's own function
/// writes in place, through links and into pipes.
fn add_pages(
    command: &clap::Command,
    pages: &mut Vec<(String, Vec<u8>)>,
) -> Result<(), std::io::Error> {
    for verb in command.get_subcommands().filter(|verb| !verb.is_hide_set()) {
        add_pages(verb, pages)?;
    }
    let (page, mut text) = (clap_mangen::Man::new(command.clone()), Vec::new());
    page.render(&mut text)?;
    pages.push((page.get_filename(), text));
    Ok(())
}
