//! Files, directories and patterns as a list of recordings.

use std::collections::HashSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::trial::Form;

/// What was found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Found {
    /// Recordings, in the order of the arguments, those of a directory by name.
    pub files: Vec<PathBuf>,
    /// What else lies in the directories: not `.npy`, `.csv` or `.csv.gz`, and not looked at.
    pub others: Vec<PathBuf>,
    /// Files that were named more than once, and count once.
    pub repeated: Vec<PathBuf>,
}

impl Found {
    /// What was named and is not among the files, in words.
    pub fn remarks(&self) -> impl Iterator<Item = String> {
        let told = |files: &[PathBuf], what: &str| {
            let first = files.first()?.display().to_string();
            Some(format!("{} {what}, the first {first}", files.len()))
        };
        let others = told(
            &self.others,
            "other files in the directories are not looked at",
        );
        let repeated = told(&self.repeated, "files are named twice and count once");
        others.into_iter().chain(repeated)
    }
}

/// Why recordings could not be found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// The operating system could not look.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// A directory without recordings.
    #[error("{path} holds no recordings (.npy, .csv, .csv.gz)", path = path.display())]
    NoRecordings {
        /// The directory.
        path: PathBuf,
    },
    /// A pattern that nothing matches.
    #[error("nothing matches {pattern:?}; * and ? stand for parts of a name, ** for directories")]
    NoMatch {
        /// The pattern.
        pattern: String,
    },
    /// Not a pattern.
    #[error("the pattern {pattern:?} is wrong at its character {at}: {reason}")]
    Pattern {
        /// The pattern.
        pattern: String,
        /// Where, from 0.
        at: usize,
        /// What is wrong.
        reason: &'static str,
    },
}

impl FindError {
    /// Whether other arguments are the remedy.
    #[must_use]
    pub const fn is_usage(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}

/// The recordings that the arguments name: files, directories with all that lies below them, and
/// patterns (`runs/**/*.npy`). A file that is named itself counts whatever its name ends in.
///
/// # Errors
/// [`FindError`]: something is not there or cannot be read, a directory or a pattern gives nothing.
pub fn find<P: AsRef<Path>>(arguments: &[P]) -> Result<Found, FindError> {
    let mut found = Found::default();
    for argument in arguments {
        let argument = argument.as_ref();
        match argument.to_str() {
            Some(pattern) if !argument.exists() && pattern.contains(['*', '?', '[']) => {
                take_pattern(pattern, &mut found)?;
            }
            _ => take(argument, &mut found)?,
        }
    }
    let mut seen = HashSet::new();
    let (files, repeated) = found.files.into_iter().partition(|path| {
        let real = path.canonicalize();
        seen.insert(real.unwrap_or_else(|_| path.clone()))
    });
    found.files = files;
    found.repeated = repeated;
    Ok(found)
}

fn take(path: &Path, found: &mut Found) -> Result<(), FindError> {
    let told = fs::metadata(path).map_err(|source| io_error(path, source))?;
    if !told.is_dir() {
        found.files.push(path.to_owned());
        return Ok(());
    }
    let before = found.files.len();
    walk(path, found)?;
    if found.files.len() == before {
        return Err(FindError::NoRecordings {
            path: path.to_owned(),
        });
    }
    Ok(())
}

fn take_pattern(pattern: &str, found: &mut Found) -> Result<(), FindError> {
    let matches = glob::glob(pattern).map_err(|error| FindError::Pattern {
        pattern: pattern.to_owned(),
        at: error.pos,
        reason: error.msg,
    })?;
    let before = found.files.len();
    for path in matches {
        let path = path.map_err(|error| {
            let at = error.path().to_owned();
            io_error(&at, error.into())
        })?;
        take(&path, found)?;
    }
    if found.files.len() == before {
        return Err(FindError::NoMatch {
            pattern: pattern.to_owned(),
        });
    }
    Ok(())
}

/// Links to directories are not followed, so that there are no circles.
fn walk(directory: &Path, found: &mut Found) -> Result<(), FindError> {
    let failed = |source| io_error(directory, source);
    let mut entries = Vec::new();
    for entry in fs::read_dir(directory).map_err(failed)? {
        entries.push(entry.map_err(failed)?.path());
    }
    entries.sort();
    for path in entries {
        let told = fs::symlink_metadata(&path).map_err(|source| io_error(&path, source))?;
        if told.is_dir() {
            walk(&path, found)?;
        } else if Form::of(&path).is_some() && path.is_file() {
            found.files.push(path);
        } else {
            found.others.push(path);
        }
    }
    Ok(())
}

fn io_error(path: &Path, source: io::Error) -> FindError {
    FindError::Io {
        path: path.to_owned(),
        source,
    }
}
