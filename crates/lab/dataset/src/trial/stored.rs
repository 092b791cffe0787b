//! Recorded trials that are read whenever they are needed: more of them than memory holds.

use std::path::{Path, PathBuf};

use super::{ColumnMap, Table, Trial, TrialError};

/// Bytes of a row in the smallest files: those compressed by gzip have about as many.
const BYTES_A_ROW: u64 = 16;

/// A file with recorded trials, or one trial of it.
#[derive(Debug, Clone)]
pub struct Stored {
    path: PathBuf,
    map: ColumnMap,
    /// Number of the trial in the file, from 0.
    number: usize,
}

impl Stored {
    /// The trials of a file, which is not opened. `map` names the columns of a CSV.
    pub fn new(path: &Path, map: &ColumnMap) -> Self {
        Self { path: path.to_owned(), map: map.clone(), number: 0 }
    }

    /// Calls `take` with each trial and its own source: those of all robots in the file, and the
    /// parts of a long one.
    ///
    /// # Errors
    /// [`TrialError`], as [`Trial::each`].
    pub fn each(&self, mut take: impl FnMut(Self, Trial)) -> Result<(), TrialError> {
        let mut number = 0;
        Trial::each(&self.path, &self.map, |trial| {
            take(Self { number, ..self.clone() }, trial);
            number += 1;
            Ok(())
        })
    }

    /// Reads the trial again: the one with its number, which needs those before it.
    ///
    /// # Errors
    /// [`TrialError`], also if the file has fewer trials now.
    pub fn read_again(&self) -> Result<Trial, TrialError> {
        let (mut left, mut wanted) = (self.number, None);
        Table::each(&self.path, &self.map, |table| {
            if left == 0 {
                wanted = Some(table);
                return Err(None);
            }
            left -= 1;
            Ok(())
        })
        .or_else(|error: Option<TrialError>| error.map_or(Ok(()), Err))?;
        wanted.unwrap_or_default().into_trial()
    }

    /// The most rows that a file of its size has.
    pub fn most_rows(&self) -> u64 {
        self.path.metadata().map_or(0, |about| about.len().div_ceil(BYTES_A_ROW))
    }
}
