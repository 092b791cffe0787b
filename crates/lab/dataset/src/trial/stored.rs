//! Recorded trials that are read whenever they are needed: more of them than memory holds.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{ColumnMap, Table, Trial, TrialError};
use crate::archive::{self, Listing};

/// Bytes of a row in the smallest files: Parquet with three columns and gzip have about as many.
const BYTES_A_ROW: u64 = 16;

/// A file with recorded trials, or one trial of an archive.
#[derive(Debug, Clone)]
pub struct Stored {
    path: PathBuf,
    source: TrialSource,
}

#[derive(Debug, Clone)]
enum TrialSource {
    /// With the number of the trial in the file, from 0.
    File(ColumnMap, usize),
    /// Number of the trial in the listing, from 0.
    Listed(Arc<Listing>, usize, ColumnMap),
}

impl Stored {
    /// The trials of a file: of the file itself, or of an archive's recording. `map` names the
    /// columns of a CSV.
    ///
    /// # Errors
    /// [`TrialError`]: a listing of an archive that cannot be read. Other files are not opened.
    pub fn find(path: &Path, map: &ColumnMap) -> Result<Vec<Self>, TrialError> {
        let stored = |source| Self { path: path.to_owned(), source };
        if !archive::is_listing(path) {
            return Ok(vec![stored(TrialSource::File(map.clone(), 0))]);
        }
        let listing = Arc::new(archive::open(path)?);
        let trials = 0..listing.trials.len();
        let each = trials
            .map(|number| stored(TrialSource::Listed(Arc::clone(&listing), number, map.clone())));
        Ok(each.collect())
    }

    /// Calls `take` with each trial and its own source: those of all robots in the file, and the
    /// parts of a long one, or the one of an archive.
    ///
    /// # Errors
    /// [`TrialError`], as [`Trial::each`].
    pub fn each(&self, mut take: impl FnMut(Self, Trial)) -> Result<(), TrialError> {
        let TrialSource::File(map, _) = &self.source else {
            take(self.clone(), self.read_again()?);
            return Ok(());
        };
        let mut number = 0;
        Trial::each(&self.path, map, |trial| {
            let source = TrialSource::File(map.clone(), number);
            let path = self.path.clone();
            take(Self { path, source }, trial);
            number += 1;
            Ok(())
        })
    }

    /// Reads the trial again: of a file the one with its number, which needs those before it.
    ///
    /// # Errors
    /// [`TrialError`], also if the file has fewer trials now.
    pub fn read_again(&self) -> Result<Trial, TrialError> {
        match &self.source {
            TrialSource::File(map, number) => {
                let (mut left, mut wanted) = (*number, None);
                Table::each(&self.path, map, |table| {
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
            TrialSource::Listed(listing, number, map) => {
                let mut table = archive::listed(&self.path, listing, *number)?;
                map.apply_sign(&mut table);
                table.into_trial()
            }
        }
    }

    /// True if the recording has other trials.
    pub fn is_one_of_several(&self) -> bool {
        match &self.source {
            TrialSource::File(..) => false,
            TrialSource::Listed(listing, ..) => listing.trials.len() > 1,
        }
    }

    /// Rows that it has, or the most that a file of its size has.
    pub fn most_rows(&self) -> u64 {
        match &self.source {
            TrialSource::File(..) => {
                self.path.metadata().map_or(0, |about| about.len().div_ceil(BYTES_A_ROW))
            }
            TrialSource::Listed(listing, number, _) => listing.trials[*number].rows,
        }
    }
}
