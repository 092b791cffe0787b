//! The ledger's files: two generations, so that damage to one costs seconds of the account instead
//! of all of it.
//!
//! `ledger.json` is the newest, `ledger.json.older` the previous one. A new one is written to a
//! temporary file, `ledger.json.new`, and renamed, so that a kill or power failure at any point
//! leaves two intact ones. If a save is cut off before its last rename, the temporary file is the
//! newest generation. The next save of any worker renames it before it writes another.

use std::collections::BTreeMap;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use joulebus_config::Config;
use joulebus_files::disk::{self, File};
use joulebus_wire::fnv1a;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{Checkpoint, LearnedCapacity, SavedAccount};
use crate::state_directory;

/// Version of files whose ledger has neither lost accounts nor errors of the energy.
const PLAIN: u32 = 3;
/// The version of files that have them. Releases that do not know them must not take such batteries
/// for new.
const LOST: u32 = 4;
/// The version of files that also have the mean power of robots with a battery.
const MEANS: u32 = 5;
/// The version of files that also have pauses of batteries, or errors of the energy.
const PAUSES: u32 = 6;
/// The version of files that also have what batteries have taught.
const NEWEST: u32 = 7;
/// The version before, without batteries: it is read, and written as a newer one.
const BEFORE: u32 = 2;
const KNOWN: [u32; 6] = [NEWEST, PAUSES, MEANS, LOST, PLAIN, BEFORE];
/// Maximum size of a file: the accounts of two million robots take about half of it.
const MAX_BYTES: u64 = 1 << 30;

/// The capacities that were learned of each robot's batteries, as a worker of this user has saved
/// them. Empty if there is no ledger that can be read.
#[must_use]
pub fn learned_capacities(config: &Config) -> BTreeMap<u32, Vec<LearnedCapacity>> {
    let saved = state_directory::ledger_path(config).map(|path| read(&path, config.fleet()));
    match saved {
        Some(Ok(Some((_, ledger)))) => ledger.capacities,
        _ => BTreeMap::new(),
    }
}

/// Contents of a file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content<C> {
    schema: u32,
    /// One more than the previous file's.
    generation: u64,
    /// FNV-1a of version (from 3 on), generation and ledger as they are written, 16 hexadecimal
    /// digits.
    fnv1a: String,
    ledger: C,
}

/// Only the version, whatever else the file contains.
#[derive(Debug, Deserialize)]
struct Version {
    schema: u32,
}

/// Reason that the ledger could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum LedgerFileError {
    /// The system call failed.
    #[error("ledger {path:?}: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// No existing file is valid.
    #[error(
        "ledger {path:?} is damaged: {reason}. There is no older one that is whole: restore a \
            copy, or move the files away to begin a new account"
    )]
    Damaged { path: PathBuf, reason: String },
    /// The file has another version.
    #[error(
        "ledger {path:?} is in version {found}, this release reads {BEFORE} to {NEWEST}: use the release \
         of joulebus that wrote it, or move the file away to begin a new account"
    )]
    Version { path: PathBuf, found: u32 },
    /// The file is of another fleet.
    #[error(
        "ledger {path:?} is of fleet {found:?}, expected {expected:?}. Give each fleet a file of \
            its own"
    )]
    Foreign { path: PathBuf, found: String, expected: String },
}

/// Location of a fleet's ledger.
#[derive(Debug, Clone)]
pub(crate) struct LedgerFiles {
    newest: PathBuf,
    /// Generation of the newest whole file.
    generation: u64,
    /// The newest whole file is the temporary one.
    is_unfinished: bool,
}

/// Reason that a file is not valid.
enum Flaw {
    Damaged(String),
    Fatal(LedgerFileError),
}

impl LedgerFiles {
    pub(crate) fn new(path: &Path) -> Self {
        Self { newest: path.to_owned(), generation: 0, is_unfinished: false }
    }

    /// The newest valid ledger of `fleet`. `None` if there is no file. A damaged file is renamed
    /// and logged.
    ///
    /// # Errors
    /// The system call failed, files exist and none is valid, or the newest is of another fleet or
    /// version.
    pub(crate) fn read(&mut self, fleet: &str) -> Result<Option<Checkpoint>, LedgerFileError> {
        let mut whole: Option<(u64, Checkpoint, PathBuf)> = None;
        let mut damaged = Vec::new();
        for path in [self.newest.clone(), self.older(), self.unfinished()] {
            let is_unfinished = path == self.unfinished();
            if is_unfinished && !disk::is_file(&path) {
                continue;
            }
            match read(&path, fleet) {
                Ok(Some((generation, ledger))) => {
                    if whole.as_ref().is_none_or(|(newest, ..)| *newest < generation) {
                        whole = Some((generation, ledger, path));
                    }
                }
                Ok(None) => {}
                // The worker was killed while writing it, or it is not the ledger's: the others are
                // intact, and the next save clears the place.
                Err(flaw) if is_unfinished && flaw.is_of_content() => {}
                Err(Flaw::Damaged(reason)) => damaged.push((path, reason)),
                Err(Flaw::Fatal(error)) => return Err(error),
            }
        }
        let Some((generation, ledger, taken)) = whole else {
            return match damaged.into_iter().next() {
                Some((path, reason)) => Err(LedgerFileError::Damaged { path, reason }),
                None => Ok(None),
            };
        };
        for (path, reason) in damaged {
            let aside = set_aside(&path)
                .map_err(|source| LedgerFileError::Io { path: path.clone(), source })?;
            tracing::error!(
                ?path, ?aside, %reason, ?taken,
                written_unix_ns = ledger.written_unix_ns,
                "a ledger is damaged: it was set aside, another generation is taken"
            );
        }
        self.is_unfinished = taken == self.unfinished();
        self.generation = generation;
        Ok(Some(ledger))
    }

    /// Makes the ledger that was read survive a power failure. The worker that wrote it may have
    /// been killed before it did so, and its successors too.
    ///
    /// # Errors
    /// The system call failed. The files are intact, and the next write does the same.
    pub(crate) fn secure(&mut self) -> Result<(), LedgerFileError> {
        let secured = match (self.is_unfinished, self.generation) {
            (true, _) => self.resume(),
            (false, 0) => Ok(()),
            // It was synced before it was renamed.
            (false, _) => disk::sync_directory(self.folder()),
        };
        secured.map_err(|source| LedgerFileError::Io { path: self.newest.clone(), source })
    }

    /// Writes the ledger atomically as the newest generation, and syncs it to the disk.
    ///
    /// # Errors
    /// The system call failed. The newest whole ledger is intact, and so is the one before it if
    /// there was one.
    pub(crate) fn write(&mut self, ledger: &Checkpoint) -> Result<(), LedgerFileError> {
        self.replace(ledger)
            .map_err(|source| LedgerFileError::Io { path: self.newest.clone(), source })
    }

    /// 1. Finish a save that was cut off: its temporary file is the newest generation.
    /// 2. Free the temporary file's name. A foreign file there is set aside.
    /// 3. Write and sync the temporary file. From here on it is the newest generation.
    /// 4. Rename the newest file to the older one, the temporary one to the newest, and sync the
    ///    directory.
    ///
    /// A kill between any two steps leaves a whole generation, which the next start finds.
    fn replace(&mut self, ledger: &Checkpoint) -> io::Result<()> {
        disk::create_dir_all(self.folder())?;
        if self.is_unfinished {
            self.resume()?;
        }
        self.clear()?;
        // Whatever comes there meanwhile is not overwritten, and a link is not followed.
        let mut file = disk::create_new(&self.unfinished())?;
        file.write_all(&encode(self.generation + 1, ledger)?)?;
        file.sync_all()?;
        drop(file);
        // If the newest is not the first generation, there is one before it. A write that failed
        // before this point reuses its number.
        self.generation += 1;
        self.is_unfinished = true;
        self.finish()
    }

    /// Frees the name of the temporary file, which is none of the generations. Removes the remains
    /// of a save that was cut off, and sets anything else aside.
    fn clear(&self) -> io::Result<()> {
        let path = self.unfinished();
        if !disk::exists(&path) {
            return Ok(());
        }
        if is_cut_off(&path)? {
            return disk::remove_file(&path);
        }
        let aside = set_aside(&path)?;
        tracing::warn!(
            ?path,
            ?aside,
            "a foreign file at the path of the ledger's temporary file was set aside"
        );
        Ok(())
    }

    /// Finishes the save that was cut off: emptied now, its file would be lost if this save is cut
    /// off too.
    fn resume(&mut self) -> io::Result<()> {
        match File::open(self.unfinished()) {
            // Whoever wrote it may have been killed before that.
            Ok(file) => file.sync_all()?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                // Somebody has removed it.
                self.is_unfinished = false;
                return Ok(());
            }
            Err(error) => return Err(error),
        }
        self.finish()
    }

    /// Renames the temporary file, which is whole and synced, to the newest one.
    fn finish(&mut self) -> io::Result<()> {
        match disk::rename(&self.newest, self.older()) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        disk::rename(self.unfinished(), &self.newest)?;
        self.is_unfinished = false;
        // Also syncs the directory, otherwise a power failure could revert the renames.
        disk::sync_directory(self.folder())
    }

    fn folder(&self) -> &Path {
        let folder = self.newest.parent();
        let named = folder.filter(|folder| !folder.as_os_str().is_empty());
        named.unwrap_or(Path::new("."))
    }

    fn older(&self) -> PathBuf {
        with(&self.newest, "older")
    }

    fn unfinished(&self) -> PathBuf {
        with(&self.newest, "new")
    }
}

fn with(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    PathBuf::from(name)
}

/// Renames a file to the first free name. However many were set aside before, none is overwritten,
/// and the fleet gets its worker: the files cost less than its absence.
fn set_aside(path: &Path) -> io::Result<PathBuf> {
    let mut number = 1_u64;
    let aside = loop {
        let name = with(path, &format!("damaged-{number}"));
        if !disk::exists(&name) {
            break name;
        }
        number += 1;
    };
    disk::rename(path, &aside)?;
    Ok(aside)
}

/// True if a file is the remains of a save that was cut off: the beginning of a ledger, or, after a
/// power failure, nothing or zeros.
fn is_cut_off(path: &Path) -> io::Result<bool> {
    if !disk::is_file(path) {
        return Ok(false);
    }
    let bytes = match joulebus_files::read(path, MAX_BYTES) {
        Err(error) if error.kind() == io::ErrorKind::FileTooLarge => return Ok(false),
        read => read?,
    };
    let begins = |schema: u32| {
        let beginning = format!("{{\"schema\":{schema},\"generation\":");
        let first = &bytes[..bytes.len().min(beginning.len())];
        beginning.as_bytes().starts_with(first) || first.iter().all(|byte| *byte == 0)
    };
    // Whole, it is another fleet's, or of another version.
    let begins = KNOWN.into_iter().any(begins);
    Ok(begins && serde_json::from_slice::<IgnoredAny>(&bytes).is_err())
}

/// The ledger's text in a file: what is read may have more fields than it was written with.
fn written(bytes: &[u8]) -> Option<&[u8]> {
    const KEY: &[u8] = b",\"ledger\":";
    let at = bytes.windows(KEY.len()).position(|part| part == KEY)?;
    bytes[at + KEY.len()..].strip_suffix(b"}")
}

fn checksum(schema: u32, generation: u64, ledger: &[u8]) -> String {
    let head = match schema {
        BEFORE => format!("[{generation},"),
        _ => format!("[{schema},{generation},"),
    };
    format!("{:016x}", fnv1a([head.as_bytes(), ledger, b"]"].concat()))
}

fn encode(generation: u64, ledger: &Checkpoint) -> Result<Vec<u8>, serde_json::Error> {
    let any = |has: fn(&SavedAccount) -> bool| ledger.robots.values().any(has);
    let schema = if any(|account| account.lessons.is_some())
        || !ledger.capacities.is_empty()
        || !ledger.errors.is_empty()
    {
        NEWEST
    } else if any(|account| account.pause.is_some()) {
        PAUSES
    } else if any(|account| account.mean_power_w.is_some()) {
        MEANS
    } else if ledger.lost.is_empty() {
        PLAIN
    } else {
        LOST
    };
    let fnv1a = checksum(schema, generation, &serde_json::to_vec(ledger)?);
    serde_json::to_vec(&Content { schema, generation, fnv1a, ledger })
}

/// True if the rest of a file, by its checksum, is of a supported version. Its version field is
/// then damaged.
fn is_of_known_version(bytes: &[u8]) -> bool {
    let Ok(content) = serde_json::from_slice::<Content<IgnoredAny>>(bytes) else {
        return false;
    };
    let is = |schema: u32, ledger| checksum(schema, content.generation, ledger) == content.fnv1a;
    written(bytes).is_some_and(|ledger| KNOWN.into_iter().any(|schema| is(schema, ledger)))
}

impl Flaw {
    /// True if the error is in the file's contents, not in reading it.
    fn is_of_content(&self) -> bool {
        match self {
            Self::Damaged(_) => true,
            Self::Fatal(LedgerFileError::Io { source, .. }) => {
                source.kind() == io::ErrorKind::FileTooLarge
            }
            Self::Fatal(_) => true,
        }
    }
}

/// Reads a file. `None` if it does not exist.
fn read(path: &Path, fleet: &str) -> Result<Option<(u64, Checkpoint)>, Flaw> {
    let failed = |source| Flaw::Fatal(LedgerFileError::Io { path: path.to_owned(), source });
    let bytes = match joulebus_files::read(path, MAX_BYTES) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(failed(error)),
    };
    if let Ok(Version { schema }) = serde_json::from_slice(&bytes)
        && !KNOWN.contains(&schema)
        && !is_of_known_version(&bytes)
    {
        return Err(Flaw::Fatal(LedgerFileError::Version { path: path.to_owned(), found: schema }));
    }
    let content: Content<Checkpoint> =
        serde_json::from_slice(&bytes).map_err(|error| Flaw::Damaged(error.to_string()))?;
    let ledger = written(&bytes).unwrap_or_default();
    let expected = checksum(content.schema, content.generation, ledger);
    if content.fnv1a != expected {
        let found = content.fnv1a;
        return Err(Flaw::Damaged(format!(
            "its checksum is {found:?}, that of its content {expected}"
        )));
    }
    if content.ledger.fleet != fleet {
        return Err(Flaw::Fatal(LedgerFileError::Foreign {
            path: path.to_owned(),
            found: content.ledger.fleet,
            expected: fleet.to_owned(),
        }));
    }
    Ok(Some((content.generation, content.ledger)))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use joulebus_fleet::ErrorCounts;

    use super::*;
    use crate::checkpoint::ModelErrors;
    use crate::checkpoint::tests::checkpoint;

    fn drawn(drawn_uj: i64) -> Checkpoint {
        let mut ledger = checkpoint();
        for account in ledger.robots.values_mut() {
            account.drawn_uj = drawn_uj;
        }
        ledger
    }

    /// A folder, and where the ledger is in it.
    fn place() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ledger.json");
        (folder, path)
    }

    fn kept(path: &Path) -> Option<i64> {
        let ledger = LedgerFiles::new(path).read("lab").unwrap()?;
        Some(ledger.robots.values().next().unwrap().drawn_uj)
    }

    /// Two generations: 100 µJ, and the previous one with 50 µJ.
    fn two(path: &Path) -> LedgerFiles {
        let mut files = LedgerFiles::new(path);
        for drawn_uj in [20, 50, 100] {
            files.write(&drawn(drawn_uj)).unwrap();
        }
        files
    }

    #[test]
    fn a_write_that_fails_is_no_generation() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("state");
        let path = state.join("ledger.json");
        let mut files = LedgerFiles::new(&path);
        fs::write(&state, "a file where the folder should be").unwrap();
        files.write(&drawn(1)).unwrap_err();
        assert_eq!(files.generation, 0);
        fs::remove_file(&state).unwrap();
        files.write(&drawn(2)).unwrap();
        files.write(&drawn(3)).unwrap();
        assert_eq!(files.generation, 2);
        assert!(with(&path, "older").exists());
        assert_eq!(kept(&path), Some(3));
    }

    #[test]
    fn what_is_not_the_ledgers_in_the_temporary_files_place_keeps_no_worker_from_starting() {
        let (folder, path) = place();
        let new = with(&path, "new");
        let another = folder.path().join("another.json");
        let mut of_another = drawn(99);
        of_another.fleet = "another".to_owned();
        LedgerFiles::new(&another).write(&of_another).unwrap();
        let whole = fs::read(&another).unwrap();
        let others: [&dyn Fn(); 5] = [
            &|| fs::create_dir(&new).unwrap(),
            &|| std::os::unix::fs::symlink(&another, &new).unwrap(),
            &|| fs::write(&new, "{\"schema\":7}").unwrap(),
            &|| fs::write(&new, &whole).unwrap(),
            &|| fs::write(&new, &whole[..whole.len() / 2]).unwrap(),
        ];
        LedgerFiles::new(&path).write(&drawn(0)).unwrap();
        for (put, drawn_uj) in others.into_iter().zip(1..) {
            put();
            assert_eq!(kept(&path), Some(drawn_uj - 1));
            let mut files = LedgerFiles::new(&path);
            files.read("lab").unwrap();
            files.secure().unwrap();
            files.write(&drawn(drawn_uj)).unwrap();
            assert_eq!(kept(&path), Some(drawn_uj));
        }
        // A save that was cut off is removed, everything else stays.
        let aside = |number| with(&new, &format!("damaged-{number}"));
        assert!(aside(1).is_dir() && aside(2).is_symlink() && !aside(5).exists());
        assert_eq!(fs::read(aside(4)).unwrap(), whole);
        assert_eq!(fs::read(&another).unwrap(), whole);
    }

    #[test]
    fn of_any_number_of_files_that_were_set_aside_none_is_overwritten() {
        let (_folder, path) = place();
        let new = with(&path, "new");
        let aside = |number| with(&new, &format!("damaged-{number}"));
        (1..=150).for_each(|number| fs::write(aside(number), "before").unwrap());
        fs::write(&new, "somebody's").unwrap();
        LedgerFiles::new(&path).write(&drawn(1)).unwrap();
        for number in 1..=150 {
            assert_eq!(fs::read_to_string(aside(number)).unwrap(), "before");
        }
        assert_eq!(fs::read_to_string(aside(151)).unwrap(), "somebody's");
        assert_eq!(kept(&path), Some(1));
    }

    #[test]
    fn what_lies_in_the_temporary_files_place_is_somebodys_or_a_cut_off_save() {
        let (folder, path) = place();
        let new = with(&path, "new");
        let aside = with(&new, "damaged-1");
        let victim = folder.path().join("victim");
        fs::write(&victim, "precious").unwrap();
        let mut files = LedgerFiles::new(&path);
        let mut save = |drawn_uj| {
            files.write(&drawn(drawn_uj)).unwrap();
            assert_eq!(kept(&path), Some(drawn_uj));
            assert!(!new.exists());
        };
        for text in ["precious", "{\"schema\":\"of another program\"}", "\0\0and more"] {
            fs::write(&new, text).unwrap();
            save(1);
            assert_eq!(fs::read_to_string(&aside).unwrap(), text);
            fs::remove_file(&aside).unwrap();
        }
        // A link, also one that leads nowhere, is moved, and not followed.
        for to in [victim.as_path(), Path::new("nowhere")] {
            std::os::unix::fs::symlink(to, &new).unwrap();
            save(2);
            assert_eq!(fs::read_link(&aside).unwrap(), to);
            fs::remove_file(&aside).unwrap();
        }
        assert_eq!(fs::read_to_string(&victim).unwrap(), "precious");
        let whole = whole(9);
        for cut_off in [&b""[..], &whole[..5], &whole[..whole.len() - 1], &[0; 40]] {
            fs::write(&new, cut_off).unwrap();
            save(3);
            assert!(!aside.exists());
        }
    }

    #[test]
    fn what_is_written_is_read_to_the_last_digit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/ledger.json");
        let mut files = LedgerFiles::new(&path);
        assert_eq!(files.read("lab").unwrap(), None);
        files.write(&checkpoint()).unwrap();
        assert_eq!(files.read("lab").unwrap(), Some(checkpoint()));
        // Relative, without a directory.
        assert_eq!(LedgerFiles::new(Path::new("no-such.json")).read("lab").unwrap(), None);
    }

    #[test]
    fn any_changed_byte_in_a_file_is_detected_and_the_older_one_used() {
        let (_folder, path) = place();
        two(&path);
        let older = with(&path, "older");
        let (whole, before) = (fs::read(&path).unwrap(), fs::read(&older).unwrap());
        let aside = with(&path, "damaged-1");
        let text = String::from_utf8(whole.clone()).unwrap();
        let edited = text.replace("\"drawn_uj\":100,", "\"drawn_uj\":100000000000,");
        assert_ne!(edited, text);
        let truncations = (0..whole.len()).map(|length| whole[..length].to_vec());
        let flips = (0..8 * whole.len()).map(|bit| {
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            flipped
        });
        for damaged in [edited.into_bytes()].into_iter().chain(truncations).chain(flips) {
            fs::write(&path, &damaged).unwrap();
            fs::write(&older, &before).unwrap();
            assert_eq!(kept(&path), Some(50), "{}", String::from_utf8_lossy(&damaged));
            assert_eq!(fs::read(&aside).unwrap(), damaged);
            assert!(!path.exists(), "the damaged file stays in place");
            fs::remove_file(&aside).unwrap();
        }
    }

    #[test]
    fn a_file_of_a_version_before_is_read_and_continued_in_this_one() {
        [BEFORE, PLAIN].into_iter().for_each(is_read_and_continued);
    }

    fn is_read_and_continued(schema: u32) {
        let (_folder, path) = place();
        let ledger = drawn(77);
        let before = serde_json::to_vec(&Content {
            schema,
            generation: 8,
            fnv1a: checksum(schema, 8, &serde_json::to_vec(&ledger).unwrap()),
            ledger: &ledger,
        });
        fs::write(&path, before.unwrap()).unwrap();
        let mut files = LedgerFiles::new(&path);
        assert_eq!(files.read("lab").unwrap(), Some(ledger));
        files.write(&drawn(78)).unwrap();
        assert_eq!(kept(&path), Some(78));
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("{\"schema\":3,\"generation\":9,"), "{text}");
    }

    #[test]
    fn a_file_whose_platforms_remember_fewer_quantities_is_read() {
        let (_folder, path) = place();
        let mut ledger = drawn(77);
        ledger.errors.push(ModelErrors { model_hash: 7, seen: ErrorCounts::default() });
        for without in [None, Some("groups")] {
            let mut value = serde_json::to_value(&ledger).unwrap();
            let seen = value["errors"][0]["seen"].as_object_mut().unwrap();
            for group in seen["groups"].as_array_mut().unwrap() {
                group.as_array_mut().unwrap().truncate(4);
            }
            without.map(|name| seen.remove(name));
            let fnv1a = checksum(PAUSES, 8, &serde_json::to_vec(&value).unwrap());
            let content = Content { schema: PAUSES, generation: 8, fnv1a, ledger: &value };
            fs::write(&path, serde_json::to_vec(&content).unwrap()).unwrap();
            assert_eq!(LedgerFiles::new(&path).read("lab").unwrap().as_ref(), Some(&ledger));
        }
    }

    /// The ledger in a file as release df6ba14 writes it, character by character.
    const DF6BA14: &str = concat!(
        r#"{"fleet":"lab","boot_id":"4876f96a-28c7-49b8-8623-2009dbb66d37","#,
        r#""written_ns":74517492152304,"written_unix_ns":1795712824457448609,"#,
        r#""robots":{"0":{"drawn_uj":102699,"drawn_remainder":1138000000,"#,
        r#""forecast_uj":102699,"metered_ns":29342734,"unmetered_ns":5,"#,
        r#""stamp_ns":74361085653668,"charged":false,"battery":{"soc":0.75,"#,
        r#""soc_lo":0.625,"soc_hi":0.875,"soc_sd":0.0625,"sensor_bias":0.0,"#,
        r#""sensor_bias_sd":0.05,"sensor_covariance":0.0,"unmetered_ns":0,"#,
        r#""changes":2,"charging":false,"measured":true}},"#,
        r#""4000000000":{"drawn_uj":-7,"drawn_remainder":0,"forecast_uj":0,"#,
        r#""metered_ns":0,"unmetered_ns":1,"stamp_ns":9,"charged":true}}}"#,
    );

    #[test]
    fn a_file_of_df6ba14_is_read_whole_and_what_this_release_writes_is_one_that_it_reads() {
        let (_folder, path) = place();
        let head = r#"{"schema":3,"generation":41,"fnv1a":"5a19a900f819c81a","ledger":"#;
        let text = format!("{head}{DF6BA14}}}");
        fs::write(&path, &text).unwrap();
        let mut files = LedgerFiles::new(&path);
        let ledger = files.read("lab").unwrap().unwrap();
        assert_eq!(ledger.robots[&0].drawn_uj, 102_699);
        // It refuses unknown fields, versions other than 2 and 3, and any other checksum.
        assert_eq!(String::from_utf8(encode(41, &ledger).unwrap()).unwrap(), text);
        files.write(&ledger).unwrap();
        assert_eq!(LedgerFiles::new(&path).read("lab").unwrap(), Some(ledger));
    }

    #[test]
    fn what_releases_before_do_not_know_is_in_a_version_that_they_refuse() {
        let lost = Checkpoint { lost: [7, u16::MAX].into(), ..drawn(77) };
        let mut mean = drawn(77);
        mean.robots.values_mut().for_each(|account| account.mean_power_w = Some(6.25));
        for (schema, ledger, part) in
            [(LOST, lost, "\"lost\":[7,65535]"), (MEANS, mean, "\"mean_power_w\":6.25")]
        {
            let (_folder, path) = place();
            LedgerFiles::new(&path).write(&ledger).unwrap();
            let text = fs::read_to_string(&path).unwrap();
            let head = format!("{{\"schema\":{schema},\"generation\":1,");
            assert!(text.starts_with(&head) && text.contains(part), "{text}");
            assert_eq!(LedgerFiles::new(&path).read("lab").unwrap(), Some(ledger));
        }
    }

    /// Bytes of generation `generation`, which has drawn as many µJ.
    fn whole(generation: u64) -> Vec<u8> {
        encode(generation, &drawn(generation as i64)).unwrap()
    }

    #[test]
    fn of_any_three_files_the_newest_whole_one_is_read_and_the_next_saves_keep_it() {
        // No file, a cut file, and generations 4 to 6.
        let contents: Vec<Option<Vec<u8>>> = [None, Some(whole(9)[..40].to_vec())]
            .into_iter()
            .chain((4..=6).map(|generation| Some(whole(generation))))
            .collect();
        let number = |place: usize| (place >= 2).then(|| place as i64 + 2);
        for places in (0..125).map(|code| [code / 25, code / 5 % 5, code % 5]) {
            let [newest, older, new] = places;
            // If both files are whole, `older` is the older one, wherever a save was cut off.
            let is_older = |one: usize, other: usize| one < 2 || other < 2 || one < other;
            if !is_older(older, newest) || !is_older(newest, new) || !is_older(older, new) {
                continue;
            }
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("ledger.json");
            let names = [path.clone(), with(&path, "older"), with(&path, "new")];
            for (name, place) in names.iter().zip(places) {
                if let Some(bytes) = &contents[place] {
                    fs::write(name, bytes).unwrap();
                }
            }
            let expected = places.into_iter().filter_map(number).max();
            let mut files = LedgerFiles::new(&path);
            let read = files.read("lab");
            if expected.is_none() {
                // The very first save was cut off, or files are damaged.
                let is_damaged = newest == 1 || older == 1;
                assert_eq!(read.is_err(), is_damaged, "{places:?}");
                continue;
            }
            let drawn_uj = |ledger: Checkpoint| ledger.robots.values().next().unwrap().drawn_uj;
            assert_eq!(read.unwrap().map(drawn_uj), expected, "{places:?}");
            files.write(&drawn(70)).unwrap();
            assert_eq!(kept(&path), Some(70), "{places:?}");
            fs::remove_file(&path).unwrap();
            assert_eq!(kept(&path), expected, "{places:?}: the one before");
            assert!(!names[2].exists(), "{places:?}");
        }
    }

    #[test]
    fn a_save_that_was_cut_off_is_finished_before_the_next_one_begins() {
        let (_folder, path) = place();
        let [older, new] = ["older", "new"].map(|ending| with(&path, ending));
        two(&path);
        fs::rename(&path, &older).unwrap();
        fs::write(&new, encode(4, &drawn(200)).unwrap()).unwrap();
        let mut files = LedgerFiles::new(&path);
        assert!(files.read("lab").unwrap().is_some());
        // A folder is not renamed to a file.
        fs::create_dir(&path).unwrap();
        assert!(files.write(&drawn(300)).is_err());
        fs::remove_dir(&path).unwrap();
        assert_eq!(kept(&path), Some(200), "it was not emptied");
        // A worker that starts finishes it.
        let mut starting = LedgerFiles::new(&path);
        assert!(starting.read("lab").unwrap().is_some());
        starting.secure().unwrap();
        assert!(!new.exists() && fs::exists(&older).unwrap());
        assert_eq!(kept(&path), Some(200));
        // Somebody removes it: the next save is written all the same.
        fs::rename(&path, &new).unwrap();
        let mut files = LedgerFiles::new(&path);
        assert!(files.read("lab").unwrap().is_some());
        fs::remove_file(&new).unwrap();
        files.write(&drawn(300)).unwrap();
        assert_eq!(kept(&path), Some(300));
    }

    #[test]
    fn the_next_save_is_the_newest_whichever_generation_was_taken() {
        let (_folder, path) = place();
        two(&path);
        fs::write(&path, "x").unwrap();
        let mut files = LedgerFiles::new(&path);
        assert!(files.read("lab").unwrap().is_some());
        files.write(&drawn(300)).unwrap();
        assert_eq!(kept(&path), Some(300));
        fs::write(&path, "y").unwrap();
        assert_eq!(kept(&path), Some(50), "what was good before the damage");
        let aside: Vec<_> = [1, 2].map(|n| with(&path, &format!("damaged-{n}"))).into();
        let texts: Vec<_> = aside.iter().map(|path| fs::read_to_string(path).unwrap()).collect();
        assert_eq!(texts, ["x", "y"], "nothing is overwritten");
    }

    #[test]
    fn without_a_valid_generation_the_error_states_file_and_reason() {
        let (_folder, path) = place();
        let error = |fleet: &str| LedgerFiles::new(&path).read(fleet).unwrap_err();
        two(&path);
        assert!(matches!(error("mine"), LedgerFileError::Foreign { .. }));
        fs::write(&path, "{}").unwrap();
        fs::write(with(&path, "older"), "").unwrap();
        assert!(matches!(error("lab"), LedgerFileError::Damaged { .. }), "{}", error("lab"));
        assert_eq!(fs::read(&path).unwrap(), b"{}", "it is left where it was");
        for (text, found) in
            [("{\"schema\":1,\"fleet\":\"lab\",\"robots\":{}}", 1), ("{\"schema\":8}", 8)]
        {
            fs::write(&path, text).unwrap();
            let error = error("lab");
            assert!(
                matches!(error, LedgerFileError::Version { found: version, .. } if version == found),
                "{error}"
            );
        }
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(matches!(error("lab"), LedgerFileError::Io { .. }));
    }
}
