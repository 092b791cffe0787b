//! Expands files, directories and patterns into a list of recordings.

use std::collections::HashSet;
use std::fs::{self, Metadata};
use std::io;
use std::path::{Path, PathBuf};

use joulebus_files::{ends_in, foreign};

use crate::trial::{Form, is_capture, try_is_capture};

/// Recordings found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Found {
    /// Recordings in the order of the arguments. Those of a directory are sorted by name.
    pub files: Vec<PathBuf>,
    /// Other files in the directories: not `.npy`, `.csv`, `.csv.gz` or a capture, ignored.
    pub others: Vec<PathBuf>,
    /// Files named more than once. Each is used once.
    pub repeated: Vec<PathBuf>,
}

impl Found {
    /// Ignored and repeated files, as messages.
    pub fn remarks(&self) -> impl Iterator<Item = String> {
        let mut ways = Vec::new();
        let remark = |files: &[PathBuf], what: &str| {
            let first = files.first()?.display().to_string();
            Some(format!("{} {what}, the first {first}", files.len()))
        };
        let others = remark(&self.others, "other files in the directories are ignored");
        let mut kinds = Vec::new();
        for file in &self.others {
            let kind = foreign::of_file(file).or_else(|| foreign::of_name(file));
            if let Some(kind) = kind.filter(|kind| !kinds.contains(kind)) {
                kinds.push(kind);
                ways.push(format!("{} is {kind}", file.display()));
            }
        }
        let repeated = remark(&self.repeated, "files are named more than once. Each is used once");
        others.into_iter().chain(ways).chain(repeated)
    }
}

/// Reason that recordings could not be found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum FindError {
    #[error("{path}: {source}", path = path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{path} holds no recordings (.npy, .csv, .csv.gz, .mcap of joulebus){other}", path = path.display())]
    NoRecordings { path: PathBuf, other: String },
    #[error("nothing matches {pattern:?}: * and ? match within a name, ** matches directories")]
    NoMatch { pattern: String },
    #[error("the pattern {pattern:?} is invalid at character {at}: {reason}")]
    Pattern { pattern: String, at: usize, reason: &'static str },
}

impl FindError {
    /// True if the arguments are at fault.
    pub const fn is_usage(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}

/// Recordings named by the arguments: files, directories (searched recursively), and patterns
/// (`runs/**/*.npy`). A file named explicitly is included whatever its extension.
///
/// # Errors
/// [`FindError`]: a path does not exist or cannot be read, or a directory or pattern yields
/// nothing.
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
    let metadata = fs::metadata(path).map_err(|source| io_error(path, source))?;
    if !metadata.is_dir() {
        joulebus_files::look(path).map_err(|source| io_error(path, source))?;
        found.files.push(path.to_owned());
        return Ok(());
    }
    let (before, others) = (found.files.len(), found.others.len());
    walk(path, found)?;
    if found.files.len() == before {
        // In what an earlier release exported, listings stand before the Parquet files.
        let mut others: Vec<&PathBuf> = found.others[others..].iter().collect();
        others.sort_by_key(|file| !ends_in(file, "parquet"));
        let other = others.into_iter().find_map(|file| {
            let kind = foreign::of_file(file).or_else(|| foreign::of_name(file))?;
            Some(format!("; {} is {kind}", file.display()))
        });
        return Err(FindError::NoRecordings {
            path: path.to_owned(),
            other: other.unwrap_or_default(),
        });
    }
    Ok(())
}

fn take_pattern(pattern: &str, found: &mut Found) -> Result<(), FindError> {
    let matches = glob::glob(&with_any_case(pattern)).map_err(|error| FindError::Pattern {
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
        return Err(FindError::NoMatch { pattern: pattern.to_owned() });
    }
    Ok(())
}

/// A pattern whose ending fits in any case: `*.csv` finds `A.CSV`.
fn with_any_case(pattern: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || ".?".contains(letter);
    let tail = pattern.trim_end_matches(is_plain).len();
    let Some(dot) = pattern[tail..].find('.') else {
        return pattern.to_owned();
    };
    let (before, ending) = pattern.split_at(tail + dot);
    let letters = ending.chars().map(|letter| match letter.is_ascii_alphabetic() {
        true => format!("[{}{}]", letter.to_ascii_lowercase(), letter.to_ascii_uppercase()),
        false => letter.to_string(),
    });
    before.to_owned() + &letters.collect::<String>()
}

/// True if a file of a directory is a recording. Its name decides, for an `.mcap` also its first record, because those of other programs
/// have to be converted. A regular file that is gone by now, or cannot be read, is one: its reader
/// reports it.
fn is_recording(path: &Path, metadata: &Metadata) -> bool {
    if metadata.is_file() {
        return Form::new(path).is_some() || try_is_capture(path).unwrap_or(true);
    }
    // A link, perhaps.
    (Form::new(path).is_some() && path.is_file()) || is_capture(path)
}

/// Symbolic links to directories are not followed, so the walk terminates.
fn walk(directory: &Path, found: &mut Found) -> Result<(), FindError> {
    let failed = |source| io_error(directory, source);
    let mut entries = Vec::new();
    for entry in fs::read_dir(directory).map_err(failed)? {
        entries.push(entry.map_err(failed)?.path());
    }
    entries.sort();
    for path in entries {
        let metadata = fs::symlink_metadata(&path).map_err(|source| io_error(&path, source))?;
        if metadata.is_dir() {
            walk(&path, found)?;
        } else if is_recording(&path, &metadata) {
            found.files.push(path);
        } else {
            found.others.push(path);
        }
    }
    Ok(())
}

fn io_error(path: &Path, source: io::Error) -> FindError {
    FindError::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_patterns_have_recordings_with_an_ending_in_any_case() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["A.CSV", "B.Npy", "C.csv.GZ", "f.csv"];
        for name in names.iter().chain(&["D.MAT", "E.PARQUET", "G.TXT"]) {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let found = |argument: &Path| {
            let files = find(&[argument]).unwrap().files.into_iter();
            let names = files.map(|file| file.file_name().unwrap().to_str().unwrap().to_owned());
            names.collect::<Vec<_>>()
        };
        assert_eq!(found(folder.path()), names);
        let remarks: Vec<String> = find(&[folder.path()]).unwrap().remarks().collect();
        for part in ["3 other files", "D.MAT is a MATLAB file", "E.PARQUET is a Parquet file"] {
            assert!(remarks.iter().any(|remark| remark.contains(part)), "{part}: {remarks:?}");
        }
        for (pattern, expected) in [
            ("*.csv", &["A.CSV", "f.csv"][..]),
            ("*.CSV", &["A.CSV", "f.csv"]),
            ("[A-C].*", &["A.CSV", "B.Npy", "C.csv.GZ"]),
            ("?.csv.gz", &["C.csv.GZ"]),
            ("b?npy", &[]),
            ("*.n?y", &["B.Npy"]),
        ] {
            let pattern = folder.path().join(pattern);
            if expected.is_empty() {
                assert!(find(&[&pattern]).is_err(), "{pattern:?}");
                continue;
            }
            assert_eq!(found(&pattern), expected, "{pattern:?}");
        }
    }

    #[test]
    fn a_folder_that_an_earlier_release_exported_is_refused_with_the_way() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [
            ("_joulebus/archive.json", &b"{\"format\":\"joulebus archive\"}"[..]),
            ("_joulebus/000000.recording", b"{\"schema\":1}"),
            ("robot=7/000000-0000.parquet", b"PAR1\x15\x04\x15"),
        ] {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, bytes).unwrap();
        }
        let refused = find(&[folder.path()]).unwrap_err().to_string();
        for part in ["000000-0000.parquet is a Parquet file", "joulebus.read_table"] {
            assert!(refused.contains(part), "{refused}");
        }
    }

    #[test]
    fn a_recording_that_is_gone_after_the_first_look_is_left_to_its_reader() {
        let folder = tempfile::tempdir().unwrap();
        let metadata = fs::symlink_metadata(tempfile::NamedTempFile::new().unwrap()).unwrap();
        for (name, expected) in
            [("a.csv", true), ("a.npy", true), ("a.mat", false), ("a.mcap", true), ("a.txt", false)]
        {
            assert_eq!(is_recording(&folder.path().join(name), &metadata), expected, "{name}");
        }
    }
}
