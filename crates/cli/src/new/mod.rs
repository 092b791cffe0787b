//! `joulebus new`: projects to start from. Their programs are the examples of the repository.

mod project;

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::ValueEnum;
use joulebus_files::WholeFolder;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use serde::Serialize;

use project::{Command, Project};

/// Write a controller or a planner to start from, with the config of its fleet
///
/// A controller publishes commands and power readings of twenty robots, a planner reads their
/// forecasts. Both run as they are. The commands that build and run them are printed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus new controller my-controller\n  \
    joulebus new planner --lang python my-planner\n  \
    joulebus new controller --lang cpp --sources ~/joulebus my-controller\n\n\
    Projects use the sources that joulebus was built from, because its packages are not published \
    yet.")]
pub(crate) struct Args {
    /// What the program does
    kind: Kind,
    /// The project's folder, new or empty
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Its language
    #[arg(long, default_value = "rust")]
    lang: Language,
    /// A clone of joulebus [default: what this program was built from, if it is still there]
    #[arg(long, value_name = "DIR")]
    sources: Option<PathBuf>,
}

/// Purpose of a project's program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Publishes what it commands and measures
    Controller,
    /// Reads forecasts
    Planner,
}

/// A project's language.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Language {
    /// Rust, by Cargo
    Rust,
    /// Python 3.10 or later
    Python,
    /// C++17, by CMake
    Cpp,
}

/// Files that were written, and the commands to go on with.
#[derive(Debug, Serialize)]
struct Written {
    folder: PathBuf,
    /// Paths below the folder.
    files: Vec<PathBuf>,
    /// The requirement that is still missing. None if the commands run as they are.
    missing: Option<String>,
    /// Once, in this order.
    prepare: Vec<Command>,
    /// Each in a terminal of its own.
    run: Vec<Command>,
}

impl fmt::Display for Written {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}:", self.folder.display())?;
        for file in &self.files {
            writeln!(out, "  {}", file.display())?;
        }
        if let Some(missing) = &self.missing {
            writeln!(out, "\nMissing: {missing}")?;
        }
        for (title, commands) in
            [("Once:", &self.prepare), ("Then, each in a terminal of its own:", &self.run)]
        {
            if !commands.is_empty() {
                writeln!(out, "\n{title}")?;
            }
            for command in commands {
                writeln!(out, "{}\n  {}", command.about, command.command)?;
            }
        }
        Ok(())
    }
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let sources = sources(args.sources.as_deref())?;
    let project = Project::new(args.kind, args.lang, &args.folder, sources.as_deref())?;
    check_empty(&args.folder)?;
    let written = WholeFolder::begin(&args.folder).and_then(|mut whole| {
        for (name, text) in &project.files {
            fs::write(whole.path(name)?, text)?;
        }
        whole.keep_new()
    });
    written.with_context(|| format!("cannot write {}", args.folder.display()))?;
    let files = project.files.iter().map(|(name, _)| PathBuf::from(name)).collect();
    output.report(&Written {
        folder: args.folder.clone(),
        files,
        missing: project.missing,
        prepare: project.prepare,
        run: project.run,
    })?;
    Ok(Outcome::Done)
}

/// The folder is empty or missing, or it is refused.
fn check_empty(folder: &Path) -> anyhow::Result<()> {
    let shown = folder.display();
    let refused = |why: &str| UsageError(format!("{shown} {why}: name a new or an empty folder"));
    match fs::metadata(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error).with_context(|| format!("cannot read {shown}")),
        Ok(found) if !found.is_dir() => Err(refused("is not a folder").into()),
        Ok(_) => {
            let mut entries =
                fs::read_dir(folder).with_context(|| format!("cannot read {shown}"))?;
            match entries.next() {
                None => Ok(()),
                Some(_) => Err(refused("is not empty").into()),
            }
        }
    }
}

/// The sources to build with: those that were named, or those that this program was built from.
fn sources(named: Option<&Path>) -> anyhow::Result<Option<PathBuf>> {
    let built_from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let is_clone = |folder: &Path| folder.join("crates/publisher/Cargo.toml").is_file();
    match (named, named.unwrap_or(&built_from)) {
        (_, folder) if is_clone(folder) => {
            let whole = fs::canonicalize(folder);
            let whole = whole.with_context(|| format!("cannot read {}", folder.display()))?;
            Ok(Some(whole))
        }
        (None, _) => Ok(None),
        (Some(named), _) => {
            let shown = named.display();
            let why =
                format!("{shown} has no crates/publisher: --sources names a clone of joulebus");
            Err(UsageError(why).into())
        }
    }
}
