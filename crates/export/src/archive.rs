//! The folder of an archive while recordings are added to it.
//!
//! Files of a recording's trials are written under other names first; its listing comes last. Whatever is not listed is
//! of an export that did not finish, and the next one removes it.

use std::collections::{HashMap, HashSet};
use std::fs::{self, OpenOptions};
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use joulebus_dataset::archive::{
    self, Head, LISTING_ENDING, LISTINGS, ListedTrial, Listing, MARK, RowStamp, SCHEMA,
};
use joulebus_dataset::trial::Table;
use joulebus_files::disk;
use joulebus_program::exit::UsageError;
use rustix::fs::{FlockOperation, flock};
use serde::{Deserialize, Serialize};

use crate::partition;

/// Ending of a file that is being written.
const DRAFT_ENDING: &str = ".part";
const PARQUET_ENDING: &str = ".parquet";

/// Contents of the file that makes a folder an archive.
#[derive(Debug, Serialize, Deserialize)]
struct Mark {
    format: String,
    schema: u32,
}

/// An archive that this process alone adds to.
#[derive(Debug)]
pub(crate) struct Archive {
    folder: PathBuf,
    /// Recordings by name.
    recordings: HashMap<String, u32>,
    next: u32,
    /// The folder was made for it.
    made_folder: bool,
    /// Its lock holds as long as it is open.
    _mark: fs::File,
}

/// A recording that is being added.
pub(crate) struct Adding<'a> {
    archive: &'a mut Archive,
    name: String,
    trials: Vec<ListedTrial>,
}

impl Archive {
    /// Opens an archive, or makes one of a new or an empty folder.
    ///
    /// # Errors
    /// Another folder, one that another export is writing, or one that cannot be read or written.
    pub(crate) fn open(folder: &Path) -> anyhow::Result<Self> {
        let shown = folder.display();
        let failed = || format!("cannot use the folder {shown}");
        let made_folder = !disk::exists(folder);
        fs::create_dir_all(folder).with_context(failed)?;
        let listings = folder.join(LISTINGS);
        if !archive::is_archive(folder) {
            let left = |entry: &Result<fs::DirEntry, std::io::Error>| {
                entry
                    .as_ref()
                    .is_ok_and(|entry| entry.file_name() != LISTINGS)
            };
            if let Some(other) = fs::read_dir(folder).with_context(failed)?.find(left) {
                let other = other.with_context(failed)?.path();
                let other = other.display();
                return Err(UsageError(format!(
                    "{shown} has other files, such as {other}; allowed are a new or an empty folder, and one of an \
                     earlier export"
                ))
                .into());
            }
            fs::create_dir_all(&listings).with_context(failed)?;
        }
        let mark = Self::lock(&listings.join(MARK), folder)?;
        let mut archive = Self {
            folder: folder.to_owned(),
            recordings: HashMap::new(),
            next: 0,
            made_folder,
            _mark: mark,
        };
        archive.take_stock().with_context(failed)?;
        Ok(archive)
    }

    /// The mark, written if it is new, and locked.
    fn lock(path: &Path, folder: &Path) -> anyhow::Result<fs::File> {
        let shown = path.display();
        let failed = || format!("cannot use {shown}");
        if disk::exists(path) {
            // Not a pipe or a device.
            joulebus_files::look(path).with_context(failed)?;
        }
        let mut mark = OpenOptions::new()
            .read(true)
            .append(true)
            .create(true)
            .open(path)
            .with_context(failed)?;
        if flock(&mark, FlockOperation::NonBlockingLockExclusive).is_err() {
            let folder = folder.display();
            bail!("another export is writing to {folder}; wait until it has ended");
        }
        let text = joulebus_files::read_to_string(path, 1 << 16).with_context(failed)?;
        if text.is_empty() {
            let contents = Mark {
                format: "joulebus archive".to_owned(),
                schema: SCHEMA,
            };
            mark.write_all(serde_json::to_string(&contents)?.as_bytes())
                .and_then(|()| mark.sync_all())
                .with_context(failed)?;
            return Ok(mark);
        }
        match serde_json::from_str::<Mark>(&text) {
            Ok(Mark { schema, .. }) if schema == SCHEMA => Ok(mark),
            Ok(Mark { schema, .. }) => Err(UsageError(format!(
                "{shown}: found schema {schema}, allowed is {SCHEMA}; export into another folder"
            ))
            .into()),
            Err(error) => Err(UsageError(format!(
                "{shown}: no mark of an archive: {error}; export into another folder"
            ))
            .into()),
        }
    }

    /// Reads what is listed, and removes what an export that did not finish has left.
    fn take_stock(&mut self) -> anyhow::Result<()> {
        let mut listed = HashSet::new();
        for path in archive::listings(&self.folder)? {
            let named = || format!("{}", path.display());
            let listing = Listing::read(&path).with_context(named)?;
            let name = path.file_name().and_then(|name| name.to_str());
            let number = name.and_then(|name| name.strip_suffix(LISTING_ENDING));
            let number: Option<u32> = number.and_then(|number| number.parse().ok());
            let Some(number) = number else {
                bail!("{}: its name is no number; remove it", path.display());
            };
            self.next = self.next.max(number + 1);
            self.recordings.insert(listing.name, number);
            listed.extend(listing.trials.into_iter().map(|trial| trial.file));
        }
        self.remove_unlisted(&listed)
    }

    fn remove_unlisted(&self, listed: &HashSet<PathBuf>) -> anyhow::Result<()> {
        let mut left = Vec::new();
        unlisted(&self.folder, Path::new(""), listed, &mut left)?;
        for path in left {
            fs::remove_file(self.folder.join(&path))?;
            // Partitions that are empty now.
            for folder in path.ancestors().skip(1).take(3) {
                let _ = fs::remove_dir(self.folder.join(folder));
            }
        }
        Ok(())
    }

    /// Removes what was written of a recording that could not be added; of an archive without recordings everything that
    /// was made for it.
    pub(crate) fn undo(mut self) {
        // What cannot be removed now, the next export removes.
        let _ = self.take_stock();
        if self.recordings.is_empty() {
            let listings = self.folder.join(LISTINGS);
            let _ = fs::remove_file(listings.join(MARK));
            let _ = fs::remove_dir(listings);
            if self.made_folder {
                let _ = fs::remove_dir(&self.folder);
            }
        }
    }

    /// Number of its recordings.
    pub(crate) fn len(&self) -> usize {
        self.recordings.len()
    }

    /// Whether a recording of that name is in it.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.recordings.contains_key(name)
    }

    /// Begins to add a recording.
    pub(crate) fn add(&mut self, name: &str) -> Adding<'_> {
        Adding {
            archive: self,
            name: name.to_owned(),
            trials: Vec::new(),
        }
    }
}

impl Adding<'_> {
    /// Writes the next trial of the recording. Returns its rows and bytes.
    ///
    /// # Errors
    /// It cannot be written.
    pub(crate) fn trial(
        &mut self,
        fleet: Option<&str>,
        table: &Table,
        stamps: Option<&[RowStamp]>,
    ) -> anyhow::Result<(u64, u64)> {
        let head = Head {
            recording: self.name.clone(),
            ordinal: self.archive.next,
            trial: u32::try_from(self.trials.len()).context("too many trials")?,
            robot: table.robot_name().map(str::to_owned),
            fleet: fleet.map(str::to_owned),
            columns: joulebus_dataset::trial::Column::ALL
                .into_iter()
                .filter(|column| table.column(*column).is_some())
                .map(|column| column.name().to_owned())
                .collect(),
            ignored_columns: table.ignored_columns().to_vec(),
            no_final_line_break: table.no_final_line_break(),
            unnamed_rows: table.unnamed_rows(),
        };
        let unix_ns = stamps.and_then(|stamps| stamps.first());
        let unix_ns = unix_ns.map(|stamp| stamp.unix_ns);
        let robot = head.robot.as_deref();
        let folder = partition::folder(fleet, unix_ns, robot);
        let (ordinal, trial) = (head.ordinal, head.trial);
        let file = folder.join(format!("{ordinal:06}-{trial:04}{PARQUET_ENDING}"));
        let draft = self.archive.folder.join(draft_of(&file));
        let failed = || format!("cannot write {}", draft.display());
        fs::create_dir_all(self.archive.folder.join(&folder)).with_context(failed)?;
        let out = fs::File::create_new(&draft).with_context(failed)?;
        let mut buffered = BufWriter::new(&out);
        let written = archive::write(table, stamps, &head, &mut buffered).with_context(failed)?;
        drop(buffered);
        out.sync_all().with_context(failed)?;
        let rows = table.rows() as u64;
        self.trials.push(ListedTrial {
            file,
            rows,
            bytes: written.bytes,
            crc32: written.crc32,
        });
        Ok((rows, written.bytes))
    }

    /// Makes the recording a part of the archive. Returns its number of trials.
    ///
    /// # Errors
    /// It cannot be written.
    pub(crate) fn finish(self) -> anyhow::Result<usize> {
        let Self {
            archive,
            name,
            trials,
        } = self;
        let root = &archive.folder;
        let failed = || format!("cannot write to {}", root.display());
        let mut folders = HashSet::new();
        for ListedTrial { file, .. } in &trials {
            fs::rename(root.join(draft_of(file)), root.join(file)).with_context(failed)?;
            folders.extend(file.ancestors().skip(1));
        }
        for folder in folders {
            disk::sync_directory(&root.join(folder)).with_context(failed)?;
        }
        let count = trials.len();
        let listing = Listing {
            schema: SCHEMA,
            name: name.clone(),
            trials,
        };
        let listings = root.join(LISTINGS);
        let path = listings.join(format!("{:06}{LISTING_ENDING}", archive.next));
        let draft = listings.join(format!("{:06}{DRAFT_ENDING}", archive.next));
        let write = || -> std::io::Result<()> {
            let mut out = fs::File::create(&draft)?;
            out.write_all(serde_json::to_string(&listing)?.as_bytes())?;
            out.sync_all()?;
            fs::rename(&draft, &path)?;
            disk::sync_directory(&listings)
        };
        write().with_context(failed)?;
        archive.recordings.insert(name, archive.next);
        archive.next += 1;
        Ok(count)
    }
}

/// The name under which a file is written: engines skip it.
fn draft_of(file: &Path) -> PathBuf {
    let name = file.file_name().unwrap_or_default().display();
    file.with_file_name(format!(".{name}{DRAFT_ENDING}"))
}

/// Files of an archive, below `folder`, that no listing names.
fn unlisted(
    root: &Path,
    folder: &Path,
    listed: &HashSet<PathBuf>,
    left: &mut Vec<PathBuf>,
) -> std::io::Result<()> {
    for entry in fs::read_dir(root.join(folder))? {
        let entry = entry?;
        let (name, kind) = (entry.file_name(), entry.file_type()?);
        let path = folder.join(&name);
        let name = name.to_string_lossy();
        if kind.is_dir() && name.contains('=') {
            unlisted(root, &path, listed, left)?;
        } else if kind.is_file()
            && is_own(&name)
            && !listed.contains(&path)
            && folder.components().count() == 3
        {
            left.push(path);
        }
    }
    Ok(())
}

/// Whether a file is named as an export names it: 000017-0003.parquet, or its draft.
fn is_own(name: &str) -> bool {
    let name = match name.strip_prefix('.') {
        Some(draft) => draft.strip_suffix(DRAFT_ENDING),
        None => Some(name),
    };
    let stem = name.and_then(|name| name.strip_suffix(PARQUET_ENDING));
    let numbers = stem.and_then(|stem| stem.split_once('-'));
    let is_number = |text: &str| text.len() >= 4 && text.bytes().all(|byte| byte.is_ascii_digit());
    numbers.is_some_and(|(recording, trial)| is_number(recording) && is_number(trial))
}
