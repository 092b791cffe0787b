//! Listings: which files of an archive are the trials of a recording.

use std::fs;
use std::io;
use std::ops::ControlFlow;
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::head::Head;
use super::read;
use super::schema::SCHEMA;
use super::sum::beginning;
use crate::trial::{Table, TrialError};

/// The folder of an archive that has the listings. Readers of Parquet skip names with a `_` at the
/// beginning.
pub const LISTINGS: &str = "_joulebus";
/// Ending of a listing's name, after the number of its recording.
pub const LISTING_ENDING: &str = ".recording";
/// The file, among the listings, that makes a folder an archive.
pub const MARK: &str = "archive.json";

/// Largest listing: one of the most robots that a recording may have is smaller.
const MAX_BYTES: u64 = 64 << 20;

/// The trials of a recording. The listing makes them a part of the archive and is written last.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listing {
    /// Version of the schema.
    pub schema: u32,
    /// Name of the recording: the file that was exported.
    pub name: String,
    /// Its trials, in their order.
    pub trials: Vec<ListedTrial>,
}

/// A trial of a listing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListedTrial {
    /// Its file, below the archive.
    pub file: PathBuf,
    /// Rows.
    pub rows: u64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Their CRC-32.
    pub crc32: u32,
}

/// Reason that a listing could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ListingError {
    /// The operating system's error.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file is no listing of this version.
    #[error("{0}")]
    Refused(String),
}

/// True if a folder is an archive.
pub fn is_archive(folder: &Path) -> bool {
    folder.join(LISTINGS).join(MARK).is_file()
}

/// True if a file is named as a listing of an archive.
pub fn is_listing(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    let folder = path.parent().and_then(Path::file_name);
    name.is_some_and(|name| name.ends_with(LISTING_ENDING))
        && folder.is_some_and(|folder| folder == LISTINGS)
}

/// The listings of an archive, in the order in which its recordings were exported.
///
/// # Errors
/// The operating system's error.
pub fn listings(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder.join(LISTINGS))? {
        let path = entry?.path();
        if is_listing(&path) {
            found.push(path);
        }
    }
    // Their numbers have leading zeros, and some may have more digits.
    found.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    Ok(found)
}

impl Listing {
    /// Reads a listing.
    ///
    /// # Errors
    /// [`ListingError`].
    pub fn read(path: &Path) -> Result<Self, ListingError> {
        let text = joulebus_files::read_to_string(path, MAX_BYTES)?;
        let remedy = "allowed is what `joulebus export` writes";
        let refused = |what: String| ListingError::Refused(format!("{what}, {remedy}"));
        let listing: Self = serde_json::from_str(&text)
            .map_err(|error| refused(format!("no listing of an archive: {error}")))?;
        if listing.schema != SCHEMA {
            let found = listing.schema;
            return Err(refused(format!("has schema {found}, allowed is {SCHEMA}")));
        }
        let is_below = |trial: &&ListedTrial| {
            let mut parts = trial.file.components();
            parts.all(|part| matches!(part, Component::Normal(_)))
        };
        match listing.trials.iter().find(|trial| !is_below(trial)) {
            None => Ok(listing),
            Some(trial) => Err(refused(format!(
                "names {}, which is not below the archive",
                trial.file.display()
            ))),
        }
    }
}

/// The trials of a listing, under the name of their recording.
pub(crate) fn each_table(
    path: &Path,
    take: &mut dyn FnMut(Table) -> ControlFlow<()>,
) -> Result<(), TrialError> {
    let listing = open(path)?;
    for number in 0..listing.trials.len() {
        if take(table(path, &listing, number)?).is_break() {
            break;
        }
    }
    Ok(())
}

/// Reads the listing at `path`.
pub(crate) fn open(path: &Path) -> Result<Listing, TrialError> {
    Listing::read(path).map_err(|error| match error {
        ListingError::Io(source) => TrialError::Io { path: path.to_owned(), source },
        ListingError::Refused(detail) => TrialError::Archive { path: path.to_owned(), detail },
    })
}

/// Trial `number` of the listing at `at`, from 0.
///
/// # Panics
/// If the listing has fewer trials.
pub(crate) fn table(at: &Path, listing: &Listing, number: usize) -> Result<Table, TrialError> {
    let trial = &listing.trials[number];
    let folder = at.parent().and_then(Path::parent);
    let path = folder.unwrap_or(Path::new("")).join(&trial.file);
    let refused = |detail: String| TrialError::Archive { path: path.clone(), detail };
    check_sum(&path, trial).map_err(|error| match error {
        ListingError::Io(source) if source.kind() == io::ErrorKind::NotFound => {
            let name = &listing.name;
            refused(format!(
                "a file of the recording {name} is missing. Bring it back, or name the partitions \
                    that are left \
                 (…/fleet=…/day=…) instead of the archive"
            ))
        }
        ListingError::Io(source) => TrialError::Io { path: path.clone(), source },
        ListingError::Refused(detail) => refused(detail),
    })?;
    let (table, head) = read::table(&path)?;
    let Head { recording, trial, .. } = &head;
    if *recording != listing.name || *trial as usize != number {
        return Err(refused(format!(
            "is trial {trial} of {recording}. Its listing has it as trial {number} of {}",
            listing.name
        )));
    }
    Ok(table)
}

/// Refuses a file that is not as it was written.
fn check_sum(path: &Path, trial: &ListedTrial) -> Result<(), ListingError> {
    let file = joulebus_files::open(path)?;
    // One byte more, so that a longer file is noticed.
    let (bytes, crc) = beginning(&file, trial.bytes.saturating_add(1))?;
    if bytes == trial.bytes && crc.finalize() == trial.crc32 {
        return Ok(());
    }
    let stated = trial.bytes;
    Err(ListingError::Refused(format!(
        "damaged: {bytes} bytes or more with another checksum than the {stated} that were \
            written. Copy it again, or \
         export the recording again"
    )))
}
