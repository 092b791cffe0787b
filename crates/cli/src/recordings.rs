//! Recordings that a user names, and how they are resampled.

use std::path::PathBuf;

use clap::ValueEnum;
use joulebus_dataset::inspect::find;
use joulebus_dataset::trial::Method;
use joulebus_program::exit::UsageError;
use joulebus_program::output::say;

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
    let found = find(paths).map_err(|error| match error.is_usage() {
        true => UsageError(error.to_string()).into(),
        false => anyhow::Error::from(error),
    })?;
    found.remarks().for_each(|remark| say(&remark));
    Ok(found.files)
}

/// How to resample.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum Resampling {
    /// The latest row
    Hold,
    /// The mean over the period that ends
    Mean,
    /// The line between the rows around
    Linear,
}

impl From<Resampling> for Method {
    fn from(how: Resampling) -> Self {
        match how {
            Resampling::Hold => Self::Hold,
            Resampling::Mean => Self::Mean,
            Resampling::Linear => Self::Linear,
        }
    }
}
