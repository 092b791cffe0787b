//! `joulebus data`: datasets.

mod check;
mod convert;
mod info;
mod simulate;

use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};
use joulebus_dataset::inspect::{FindError, Found, find};
use joulebus_dataset::trial::Method;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::{Output, say};

/// Look at recorded trials, check them, write them in another form, and write simulated ones
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus data info recordings/*.csv.gz\n  \
    joulebus data check recordings/\n  \
    joulebus data convert trial1.npy --out trial1.csv.gz\n  \
    joulebus data simulate simulated")]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Info(info::Args),
    Check(check::Args),
    Convert(convert::Args),
    Simulate(simulate::Args),
}

/// Recordings.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Recordings {
    /// Recordings (.npy, .csv, .csv.gz), directories with all that lies below them, or patterns in
    /// quotes: 'runs/**/*.npy'
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
}

impl Recordings {
    /// The files, as [`find_recordings`] gives them.
    pub(crate) fn find(&self) -> anyhow::Result<Vec<PathBuf>> {
        find_recordings(&self.paths)
    }
}

/// The files that are named; what else lies in the directories, and what was named twice, is said on
/// stderr.
///
/// # Errors
/// Something named is not there, or holds no recordings.
pub(crate) fn find_recordings(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let Found {
        files,
        others,
        repeated,
    } = find(paths).map_err(refused)?;
    if let [first, ..] = others.as_slice() {
        let (count, name) = (others.len(), first.display());
        say(&format!(
            "{count} other files in the directories are not looked at, the first {name}"
        ));
    }
    if let [first, ..] = repeated.as_slice() {
        let (count, name) = (repeated.len(), first.display());
        say(&format!(
            "{count} files are named twice and count once, the first {name}"
        ));
    }
    Ok(files)
}

/// How to resample.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum How {
    /// The latest row
    Hold,
    /// The mean over the period that ends
    Mean,
    /// The line between the rows around
    Linear,
}

impl From<How> for Method {
    fn from(how: How) -> Self {
        match how {
            How::Hold => Self::Hold,
            How::Mean => Self::Mean,
            How::Linear => Self::Linear,
        }
    }
}

fn refused(error: FindError) -> anyhow::Error {
    match error {
        FindError::Io { .. } => error.into(),
        error => UsageError(error.to_string()).into(),
    }
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.what {
        What::Info(args) => info::run(args, output),
        What::Check(args) => check::run(args, output),
        What::Convert(args) => convert::run(args, output),
        What::Simulate(args) => simulate::run(args, output),
    }
}
