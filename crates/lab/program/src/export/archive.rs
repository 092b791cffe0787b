//! The folder of an archive while recordings are added to it.
//!
//! The files of a recording's trials are written under temporary names, then the draft of its
//! listing. Then all get their final names, the listing last. An interrupted export therefore
//! leaves drafts and the files that the draft of the listing names, and the next export removes
//! them. Other files belong to somebody else. No link is followed, because anybody may have made
//! the archive.

use std::collections::{HashMap, HashSet};
use std::fs::{self, OpenOptions};
use std::io::{self, BufWriter, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use joulebus_dataset::archive::{
    self, Head, LISTING_ENDING, LISTINGS, ListedTrial, Listing, MARK, RowStamp, SCHEMA,
};
use joulebus_dataset::trial::Table;
use joulebus_files::disk;
use joulebus_program::exit::UsageError;
use rustix::fs::{CWD, FlockOperation, OFlags, RenameFlags, flock, renameat_with};
use rustix::io::Errno;
use serde::{Deserialize, Serialize};

use super::partition::{self, Levels, Partition};

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
    /// Levels that its folders name. Unknown before the first trial.
    levels: Option<Levels>,
    /// True if a trial may lack some of it.
    is_mixed: bool,
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
    pub(crate) fn open(folder: &Path, is_mixed: bool) -> anyhow::Result<Self> {
        let shown = folder.display();
        let failed = || format!("cannot use the folder {shown}");
        let made_folder = !disk::exists(folder);
        fs::create_dir_all(folder).with_context(failed)?;
        let listings = folder.join(LISTINGS);
        if !archive::is_archive(folder) {
            let left = |entry: &Result<fs::DirEntry, std::io::Error>| {
                entry.as_ref().is_ok_and(|entry| entry.file_name() != LISTINGS)
            };
            if let Some(other) = fs::read_dir(folder).with_context(failed)?.find(left) {
                let other = other.with_context(failed)?.path();
                let other = other.display();
                return Err(UsageError(format!(
                    "{shown} has other files, such as {other}, allowed are a new or an empty \
                        folder, and one of an \
                     earlier export"
                ))
                .into());
            }
            fs::create_dir_all(&listings).with_context(failed)?;
        }
        own_folder(&listings)?;
        let mark = Self::lock(&listings.join(MARK), folder)?;
        let mut archive = Self {
            folder: folder.to_owned(),
            recordings: HashMap::new(),
            next: 0,
            levels: None,
            is_mixed,
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
            .custom_flags(OFlags::NOFOLLOW.bits().cast_signed())
            .open(path)
            .with_context(failed)?;
        if flock(&mark, FlockOperation::NonBlockingLockExclusive).is_err() {
            let folder = folder.display();
            bail!("another export is writing to {folder}. Wait until it has ended");
        }
        let text = joulebus_files::read_to_string(path, 1 << 16).with_context(failed)?;
        if text.is_empty() {
            let contents = Mark { format: "joulebus archive".to_owned(), schema: SCHEMA };
            mark.write_all(serde_json::to_string(&contents)?.as_bytes())
                .and_then(|()| mark.sync_all())
                .with_context(failed)?;
            return Ok(mark);
        }
        match serde_json::from_str::<Mark>(&text) {
            Ok(Mark { schema, .. }) if schema == SCHEMA => Ok(mark),
            Ok(Mark { schema, .. }) => Err(UsageError(format!(
                "{shown}: found schema {schema}, allowed is {SCHEMA}. Export into another folder"
            ))
            .into()),
            Err(error) => Err(UsageError(format!(
                "{shown}: no mark of an archive: {error}. Export into another folder"
            ))
            .into()),
        }
    }

    /// Reads the listings, and removes the remains of an interrupted export.
    fn take_stock(&mut self) -> anyhow::Result<()> {
        let mut listed = HashSet::new();
        for path in archive::listings(&self.folder)? {
            let named = || format!("{}", path.display());
            let listing = Listing::read(&path).with_context(named)?;
            let name = path.file_name().and_then(|name| name.to_str());
            let number = name.and_then(|name| name.strip_suffix(LISTING_ENDING));
            let number: Option<u32> = number.and_then(|number| number.parse().ok());
            let Some(number) = number else {
                bail!("{}: its name is no number. Remove it", path.display());
            };
            let Some(after) = number.checked_add(1) else {
                bail!("{}: allowed are numbers below {number}. Give it another", path.display());
            };
            self.next = self.next.max(after);
            self.recordings.insert(listing.name, number);
            for trial in &listing.trials {
                self.levels.get_or_insert(Levels::of_file(&trial.file));
                self.is_mixed |= partition::is_of_nothing(&trial.file);
            }
            listed.extend(listing.trials.into_iter().map(|trial| trial.file));
        }
        self.remove_unfinished(&listed)
    }

    /// Draft of the next listing.
    fn draft(&self) -> PathBuf {
        let name = format!("{:06}{DRAFT_ENDING}", self.next);
        self.folder.join(LISTINGS).join(name)
    }

    fn remove_unfinished(&self, listed: &HashSet<PathBuf>) -> anyhow::Result<()> {
        let (mut left, draft) = (Vec::new(), self.draft());
        drafts(&self.folder, Path::new(""), &mut left)?;
        // Some may have their names already.
        if let Ok(unfinished) = Listing::read(&draft) {
            let is_its = |trial: &ListedTrial| {
                let found = fs::symlink_metadata(self.folder.join(&trial.file));
                let before = draft_of(&trial.file);
                let is_own =
                    before.file_name().is_some_and(|name| is_draft(&name.to_string_lossy()));
                // The draft is gone, so the file got its final name.
                let has_moved = fs::symlink_metadata(self.folder.join(&before)).is_err();
                is_own
                    && has_moved
                    && found.is_ok_and(|found| found.is_file() && found.len() == trial.bytes)
                    && !listed.contains(&trial.file)
                    && trial
                        .file
                        .parent()
                        .is_some_and(|folder| make_folders(&self.folder, folder).is_ok())
            };
            let named = unfinished.trials.into_iter().filter(is_its);
            left.extend(named.map(|trial| trial.file));
        }
        if fs::symlink_metadata(&draft).is_ok_and(|found| found.is_file()) {
            left.push(Path::new(LISTINGS).join(draft.file_name().unwrap_or_default()));
        }
        for path in left {
            fs::remove_file(self.folder.join(&path))?;
            if path.starts_with(LISTINGS) {
                continue;
            }
            // Partitions that are empty now.
            for folder in path.ancestors().skip(1).take(3) {
                let _ = fs::remove_dir(self.folder.join(folder));
            }
        }
        Ok(())
    }

    /// Removes the files of a recording that could not be added. Of an archive without recordings
    /// it removes everything that was made for it.
    pub(crate) fn undo(mut self) {
        // The next export removes what cannot be removed now.
        let _ = self.take_stock();
        if self.recordings.is_empty() {
            let listings = self.folder.join(LISTINGS);
            remove_empty(&self.folder);
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

    /// True if a recording of that name is in it.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.recordings.contains_key(name)
    }

    /// Levels of the archive's folders, for a trial of the recording `name` whose own levels are
    /// `own`. pandas and Dask read no archive in which some trials lack a part of it.
    ///
    /// # Errors
    /// The trials before have something else.
    pub(crate) fn levels(&mut self, name: &str, own: Levels) -> anyhow::Result<Levels> {
        let is_mixed = self.is_mixed;
        let first = if is_mixed { Levels::ALL } else { own };
        let levels = *self.levels.get_or_insert(first);
        if own == levels || (is_mixed && levels == Levels::ALL) {
            return Ok(levels);
        }
        let mut what = format!(
            "{name}: a trial has {}, those in {} have {}. pandas and Dask cannot read an archive \
                of both: export it into \
             another folder, or name the robot that a file lacks with --map robot:=NAME",
            own.names(),
            self.folder.display(),
            levels.names(),
        );
        what += match levels == Levels::ALL {
            true => ", or give --mixed for DuckDB, Polars and pyarrow",
            false => ", or export all of it again with --mixed for DuckDB, Polars and pyarrow",
        };
        Err(UsageError(what).into())
    }

    /// Begins to add a recording.
    pub(crate) fn add(&mut self, name: &str) -> Adding<'_> {
        Adding { archive: self, name: name.to_owned(), trials: Vec::new() }
    }
}

impl Adding<'_> {
    /// Writes the next trial of the recording. Returns its rows and bytes.
    ///
    /// # Errors
    /// The trial cannot be written.
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
            sources: table.sources().to_vec(),
            time_name: table.time_name().map(str::to_owned),
            states_time_unit: table.states_time_unit(),
            left_out: table.left_out().clone(),
            understood: table.understood().to_vec(),
        };
        let unix_ns = stamps.and_then(|stamps| stamps.first());
        let unix_ns = unix_ns.map(|stamp| stamp.unix_ns);
        let robot = head.robot.as_deref();
        let partition = Partition::new(fleet, unix_ns, robot);
        let levels = self.archive.levels(&self.name, partition.levels())?;
        let folder = partition.folder(levels);
        let (ordinal, trial) = (head.ordinal, head.trial);
        let file = folder.join(format!("{ordinal:06}-{trial:04}{PARQUET_ENDING}"));
        let draft = self.archive.folder.join(draft_of(&file));
        let failed = || format!("cannot write {}", draft.display());
        make_folders(&self.archive.folder, &folder)?;
        let out = fs::File::create_new(&draft).with_context(failed)?;
        let mut buffered = BufWriter::new(&out);
        let written = archive::write(table, stamps, &head, &mut buffered).with_context(failed)?;
        drop(buffered);
        out.sync_all().with_context(failed)?;
        let rows = table.rows() as u64;
        self.trials.push(ListedTrial { file, rows, bytes: written.bytes, crc32: written.crc32 });
        Ok((rows, written.bytes))
    }

    /// Makes the recording a part of the archive. Returns its number of trials.
    ///
    /// # Errors
    /// The recording cannot be written.
    pub(crate) fn finish(self) -> anyhow::Result<usize> {
        let Self { archive, name, trials } = self;
        let root = &archive.folder;
        let failed = || format!("cannot write to {}", root.display());
        let listing = Listing { schema: SCHEMA, name: name.clone(), trials };
        let listings = root.join(LISTINGS);
        let path = listings.join(format!("{:06}{LISTING_ENDING}", archive.next));
        let draft = archive.draft();
        let prepare = || -> std::io::Result<()> {
            let mut out = fs::File::create_new(&draft)?;
            out.write_all(serde_json::to_string(&listing)?.as_bytes())?;
            out.sync_all()?;
            disk::sync_directory(&listings)
        };
        prepare().with_context(failed)?;
        let mut changed = HashSet::new();
        for ListedTrial { file, .. } in &listing.trials {
            rename_new(&root.join(draft_of(file)), &root.join(file)).with_context(failed)?;
            changed.extend(file.ancestors().skip(1));
        }
        for folder in changed {
            disk::sync_directory(&root.join(folder)).with_context(failed)?;
        }
        rename_new(&draft, &path)
            .and_then(|()| disk::sync_directory(&listings))
            .with_context(failed)?;
        let count = listing.trials.len();
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

/// Drafts of an archive, below `folder`.
fn drafts(root: &Path, folder: &Path, left: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in fs::read_dir(root.join(folder))? {
        let entry = entry?;
        let (name, kind) = (entry.file_name(), entry.file_type()?);
        let path = folder.join(&name);
        let name = name.to_string_lossy();
        if kind.is_dir() && name.contains('=') {
            drafts(root, &path, left)?;
        } else if kind.is_file() && is_draft(&name) && folder.components().count() <= 3 {
            left.push(path);
        }
    }
    Ok(())
}

/// Removes the folders of partitions below `folder` that have no files.
fn remove_empty(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_string_lossy().contains('=') {
            remove_empty(&entry.path());
            let _ = fs::remove_dir(entry.path());
        }
    }
}

/// Makes the folders of a partition below the archive itself: a link among them would lead
/// elsewhere.
fn make_folders(root: &Path, folder: &Path) -> anyhow::Result<()> {
    let mut path = root.to_owned();
    for name in folder {
        path.push(name);
        match fs::create_dir(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => own_folder(&path)?,
            made => made.with_context(|| format!("cannot make {}", path.display()))?,
        }
    }
    Ok(())
}

/// Refuses a link in place of a folder of the archive.
fn own_folder(path: &Path) -> anyhow::Result<()> {
    let shown = path.display();
    let found = fs::symlink_metadata(path).with_context(|| format!("cannot use {shown}"))?;
    if !found.is_dir() {
        bail!("{shown} is a link or no folder: an archive's folders lie in it. Move it away");
    }
    Ok(())
}

/// Renames a file to a name that is free.
fn rename_new(from: &Path, to: &Path) -> std::io::Result<()> {
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // The file system does not know how.
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) if !disk::exists(to) => {
            fs::rename(from, to)
        }
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => {
            Err(io::ErrorKind::AlreadyExists.into())
        }
        renamed => Ok(renamed?),
    }
}

/// True if a file is named as the draft of an export: .000017-0003.parquet.part.
fn is_draft(name: &str) -> bool {
    let name = name.strip_prefix('.');
    let name = name.and_then(|name| name.strip_suffix(DRAFT_ENDING));
    let stem = name.and_then(|name| name.strip_suffix(PARQUET_ENDING));
    let numbers = stem.and_then(|stem| stem.split_once('-'));
    let is_number = |text: &str| text.len() >= 4 && text.bytes().all(|byte| byte.is_ascii_digit());
    numbers.is_some_and(|(recording, trial)| is_number(recording) && is_number(trial))
}
