//! Files that appear when they are whole: a program that fails, or is killed, leaves none of them
//! half written.

use std::fs::{self, File};
use std::io;
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::{FileExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use rustix::fs::{
    AtFlags, CWD, FlockOperation, Mode, OFlags, RenameFlags, flock, linkat, open, renameat_with,
};
use rustix::io::Errno;

use crate::{Refused, disk, look};

/// Permissions before the user's mask: recordings and what is computed of them are their owner's
/// alone, as they tell where robots were.
const PRIVATE: u32 = 0o600;
/// Permissions before the user's mask of what others run: configs, models, programs.
const SHARED: u32 = 0o666;
/// The names of files and folders that are not whole yet: this, the process and a number.
const HIDDEN: &str = ".joulebus-";
/// Maximum number of bytes that identify the kind of a file.
pub(crate) const MAX_KIND_BYTES: usize = 9;
const MAGIC_BYTES: usize = 4;
/// Maximum number of temporary names tried beside the target.
const MAX_NAMES: u32 = 1_000;

/// Writes a new file at `path`, which only its owner can read. Nothing may exist there, not even a
/// dangling link.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] if something exists, before `write` is called or after it.
/// Errors of the system and of `write`.
pub fn create<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&File) -> Result<T, E>,
) -> Result<T, E> {
    if disk::exists(path) {
        return Err(taken().into());
    }
    let draft = Draft::begin(path, PRIVATE)?;
    let written = write(&draft.file)?;
    draft.link(path)?;
    Ok(written)
}

/// Writes a file at `path`, which only its owner can read, and replaces the file of an earlier run:
/// a regular file that is empty or begins like the new one. A link is replaced, not followed.
///
/// # Errors
/// [`Refused::Kind`](crate::Refused::Kind) for a pipe, a device, a directory or a link to one.
/// [`Refused::Foreign`](crate::Refused::Foreign). Errors of the system and of `write`.
pub fn replace<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&File) -> Result<T, E>,
) -> Result<T, E> {
    replace_with(path, PRIVATE, write)
}

/// Same as [`replace`], for a file that others may run or read as far as the user's mask allows: a
/// config, a model, a program.
///
/// # Errors
/// Those of [`replace`].
pub fn replace_shared<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&File) -> Result<T, E>,
) -> Result<T, E> {
    replace_with(path, SHARED, write)
}

fn replace_with<T, E: From<io::Error>>(
    path: &Path,
    mode: u32,
    write: impl FnOnce(&File) -> Result<T, E>,
) -> Result<T, E> {
    match look(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
        _ => {}
    }
    let draft = Draft::begin(path, mode)?;
    let written = write(&draft.file)?;
    draft.replace(path)?;
    Ok(written)
}

/// Checks whether [`replace`] may write a file that begins with `beginning`, for programs that
/// would learn it after hours.
///
/// # Errors
/// [`Refused::Foreign`](crate::Refused::Foreign) if another file is there, and those of
/// [`open`](crate::open()).
pub fn check_kind(path: &Path, beginning: &[u8]) -> io::Result<()> {
    let file = match crate::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        opened => opened?,
    };
    let mut found = [0; MAX_KIND_BYTES];
    let length = file.read_at(&mut found, 0)?;
    if is_of_kind(&found[..length], beginning) {
        return Ok(());
    }
    let found = String::from_utf8_lossy(&found[..length]).into_owned();
    Err(Refused::Foreign { found }.into())
}

fn is_of_kind(found: &[u8], beginning: &[u8]) -> bool {
    // Safetensors begin with the length of their header.
    let is_tensors = |file: &[u8]| file.get(6..MAX_KIND_BYTES) == Some(b"\0\0{");
    let magic = &beginning[..beginning.len().min(MAGIC_BYTES)];
    found.is_empty() || found.starts_with(magic) || (is_tensors(found) && is_tensors(beginning))
}

pub(crate) fn taken() -> io::Error {
    let what = "the file exists and is not overwritten. Name another";
    io::Error::new(io::ErrorKind::AlreadyExists, what)
}

/// A file that is being written.
///
/// It has no name, so the system removes it however the program ends. If the file system cannot do
/// that, it has a [hidden name](beside) beside its target, which is removed when the draft is
/// dropped.
#[derive(Debug)]
struct Draft {
    file: File,
    hidden: Option<PathBuf>,
}

impl Drop for Draft {
    fn drop(&mut self) {
        if let Some(hidden) = &self.hidden {
            let _ = disk::remove_file(hidden);
        }
    }
}

impl Draft {
    /// Begins the file for `path`. Removes what killed processes have left beside it.
    fn begin(path: &Path, mode: u32) -> io::Result<Self> {
        remove_dead(path.parent().filter(|folder| !folder.as_os_str().is_empty()));
        match unnamed(path, mode) {
            Err(error) if is_unsupported(&error) => Self::begin_named(path, mode),
            file => Ok(Self { file: file?, hidden: None }),
        }
    }

    fn begin_named(path: &Path, mode: u32) -> io::Result<Self> {
        let (file, hidden) = beside(path, |hidden| {
            let mut options = File::options();
            options.read(true).write(true).create_new(true).mode(mode).open(hidden)
        })?;
        Ok(Self { file, hidden: Some(hidden) })
    }

    /// Gives the file its name, and replaces one of an earlier run, which begins like it.
    fn replace(mut self, path: &Path) -> io::Result<()> {
        let mut beginning = [0; MAX_KIND_BYTES];
        let length = self.file.read_at(&mut beginning, 0)?;
        check_kind(path, &beginning[..length])?;
        // A power failure must not leave a part of it in the place of the file before.
        self.file.sync_all()?;
        let hidden = match self.hidden.take() {
            Some(hidden) => hidden,
            None if !disk::exists(path) && self.name(path).is_ok() => return Ok(()),
            None => {
                // Locked before it has a name: nobody takes it for one of a process that is gone.
                let _ = flock(&self.file, FlockOperation::NonBlockingLockExclusive);
                beside(path, |hidden| self.name(hidden).and_then(|()| self.file.try_clone()))?.1
            }
        };
        let renamed = disk::rename(&hidden, path);
        if renamed.is_err() {
            self.hidden = Some(hidden);
        }
        renamed
    }

    /// Gives the file its name, which must be free.
    fn link(mut self, path: &Path) -> io::Result<()> {
        let Some(hidden) = &self.hidden else {
            return self.name(path);
        };
        if rename_new(hidden, path)? {
            self.hidden = None;
        }
        Ok(())
    }

    /// Gives a file without a name one.
    fn name(&self, path: &Path) -> io::Result<()> {
        let from = format!("/proc/self/fd/{}", self.file.as_raw_fd());
        linkat(CWD, from, CWD, path, AtFlags::SYMLINK_FOLLOW).map_err(|error| match error {
            Errno::EXIST => taken(),
            error => error.into(),
        })
    }
}

/// A file without a name in the folder of `path`.
fn unnamed(path: &Path, mode: u32) -> io::Result<File> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
    let file = open(folder.unwrap_or(Path::new(".")), flags, Mode::from_raw_mode(mode))?;
    Ok(file.into())
}

/// True if the file system has no files without a name.
fn is_unsupported(error: &io::Error) -> bool {
    let found = Errno::from_io_error(error);
    found.is_some_and(|found| matches!(found, Errno::OPNOTSUPP | Errno::ISDIR | Errno::INVAL))
}

/// Checks that a file can be made beside `path`.
pub(crate) fn check_beside(path: &Path) -> io::Result<()> {
    Draft::begin(path, PRIVATE).map(drop)
}

/// Renames a file to a name that must be free. False if `hidden` stays as its second name.
pub(crate) fn rename_new(hidden: &Path, path: &Path) -> io::Result<bool> {
    match renameat_with(CWD, hidden, CWD, path, RenameFlags::NOREPLACE) {
        Ok(()) => Ok(true),
        // Linking fails if the name is taken.
        Err(Errno::INVAL | Errno::NOSYS) => fs::hard_link(hidden, path).map(|()| false),
        Err(Errno::EXIST) => Err(taken()),
        Err(error) => Err(error.into()),
    }
}

/// Creates a file or folder under a free hidden name beside `path`, and locks it for as long as
/// this process has it open: one that nobody locks is [removed](remove_dead).
pub(crate) fn beside(
    path: &Path,
    mut make: impl FnMut(&Path) -> io::Result<File>,
) -> io::Result<(File, PathBuf)> {
    let mut number = 0;
    loop {
        // Not after the file, whose name may be as long as names may be.
        let name = format!("{HIDDEN}{}-{number}", std::process::id());
        let hidden = path.with_file_name(name);
        match make(&hidden) {
            // Another process may remove it before it is locked.
            Ok(made) if is_own(&made, &hidden) => return Ok((made, hidden)),
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists || number >= MAX_NAMES => {
                return Err(error);
            }
            _ if number >= MAX_NAMES => return Err(io::ErrorKind::AlreadyExists.into()),
            _ => number += 1,
        }
    }
}

/// Locks what has this name. False if another process removes it. Where the file system has no
/// locks, nobody removes anything.
fn is_own(made: &File, hidden: &Path) -> bool {
    let locked = flock(made, FlockOperation::NonBlockingLockExclusive);
    locked != Err(Errno::WOULDBLOCK)
        && disk::id(made).is_ok_and(|id| {
            disk::found_at(hidden).is_ok_and(|there| there.is_some_and(|(there, _)| there == id))
        })
}

/// Removes what killed processes have left in a folder under hidden names.
fn remove_dead(folder: Option<&Path>) {
    let entries = fs::read_dir(folder.unwrap_or(Path::new("."))).into_iter().flatten();
    for path in entries.flatten().map(|entry| entry.path()) {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let numbers = name.strip_prefix(HIDDEN).unwrap_or_default();
        if numbers.is_empty() || !numbers.bytes().all(|letter| b"0123456789-".contains(&letter)) {
            continue;
        }
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let Ok(left) = open(&path, flags, Mode::empty()) else { continue };
        if flock(&left, FlockOperation::NonBlockingLockExclusive).is_ok() {
            // Whatever stays is looked at again by the next.
            let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::io::Write as _;
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    use super::*;

    fn text(of: &'static str) -> impl Fn(&File) -> io::Result<()> {
        move |mut file| file.write_all(of.as_bytes())
    }

    fn failing(mut file: &File) -> io::Result<()> {
        file.write_all(b"half of it")?;
        Err(io::ErrorKind::StorageFull.into())
    }

    fn names(folder: &Path) -> Vec<OsString> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_new_file_is_whole_or_not_there_and_takes_nobodys_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out");
        let failed = create(&path, failing).unwrap_err();
        assert_eq!(failed.kind(), io::ErrorKind::StorageFull);
        assert!(names(folder.path()).is_empty());
        create(&path, text("first")).unwrap();
        let refused = create(&path, |_| -> io::Result<()> { panic!("asked first") }).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::AlreadyExists);
        fs::remove_file(&path).unwrap();
        symlink("nowhere", &path).unwrap();
        assert!(create(&path, text("second")).is_err());
        fs::remove_file(&path).unwrap();
        // The other file appears while this one is written.
        let late = create(&path, |mut file| {
            fs::write(&path, "somebody's")?;
            file.write_all(b"mine")
        });
        assert_eq!(late.unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read_to_string(&path).unwrap(), "somebody's");
        assert_eq!(names(folder.path()), ["out"]);
    }

    #[test]
    fn a_file_is_replaced_as_a_whole_and_what_is_no_file_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("out"), folder.path().join("other"));
        replace(&path, text("first")).unwrap();
        assert!(replace(&path, failing).is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
        replace(&path, text("first, again")).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "first, again");
        fs::write(&other, "somebody's").unwrap();
        fs::remove_file(&path).unwrap();
        symlink(&other, &path).unwrap();
        replace(&path, text("some")).unwrap();
        assert_eq!(fs::read_to_string(&other).unwrap(), "somebody's");
        assert_eq!(fs::read_to_string(&path).unwrap(), "some");
        assert!(replace(folder.path(), text("a directory")).is_err());
        let pipe = folder.path().join("pipe");
        rustix::fs::mkfifoat(CWD, &pipe, Mode::from_raw_mode(0o600)).unwrap();
        assert!(replace(&pipe, text("a pipe")).is_err());
        assert_eq!(names(folder.path()), ["other", "out", "pipe"]);
    }

    #[test]
    fn only_what_an_earlier_run_may_have_written_is_replaced() {
        const TENSORS: &[u8] = b"\x40\x01\0\0\0\0\0\0{\"a";
        const OTHER_TENSORS: &[u8] = b"\x18\x22\0\0\0\0\0\0{\"__";
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out");
        for (there, written, is_replaced) in [
            (&b""[..], &b"<svg"[..], true),
            (b"<svg width", b"<svg height", true),
            (b"<svg", b"", true),
            (b"{\n  \"a\"", b"{\n  \"b\"", true),
            (TENSORS, OTHER_TENSORS, true),
            (b"precious", b"<svg", false),
            (b"<s", b"<svg", false),
            (b"precious", OTHER_TENSORS, false),
            (TENSORS, b"{\n  ", false),
            (b"\0\0\0", TENSORS, false),
        ] {
            fs::write(&path, there).unwrap();
            let replaced = replace(&path, |mut file| file.write_all(written));
            assert_eq!(replaced.is_ok(), is_replaced, "{there:?} {written:?}");
            assert_eq!(check_kind(&path, written).is_ok(), is_replaced);
            let kept = if is_replaced { written } else { there };
            assert_eq!(fs::read(&path).unwrap(), kept);
            if let Err(error) = replaced {
                assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
            }
        }
        assert_eq!(names(folder.path()), ["out"]);
    }

    #[test]
    fn where_files_need_names_the_promises_are_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out");
        let begin = || {
            let draft = Draft::begin_named(&path, PRIVATE).unwrap();
            text("it")(&draft.file).unwrap();
            draft
        };
        drop(begin());
        assert!(names(folder.path()).is_empty());
        begin().link(&path).unwrap();
        assert!(begin().link(&path).is_err());
        fs::write(&path, "it was").unwrap();
        let (one, two) = (begin(), begin());
        one.replace(&path).unwrap();
        two.replace(&path).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "it");
        assert!(begin().replace(&folder.path().join("no/such/folder")).is_err());
        assert_eq!(names(folder.path()), ["out"]);
    }

    #[test]
    fn what_killed_processes_left_is_removed_and_what_others_write_or_own_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for left in [".joulebus-1-0", ".joulebus-own", ".joulebus-", "joulebus-1-0"] {
            fs::write(at(left), "half").unwrap();
        }
        fs::create_dir(at(".joulebus-1-1")).unwrap();
        fs::write(at(".joulebus-1-1/one"), "one").unwrap();
        symlink(at(".joulebus-own"), at(".joulebus-1-2")).unwrap();
        let (_written, hidden) = beside(&at("out"), |hidden| File::create_new(hidden)).unwrap();
        create(&at("out"), text("whole")).unwrap();
        let own = [".joulebus-", ".joulebus-1-2", ".joulebus-own", "joulebus-1-0", "out"];
        let kept = hidden.file_name().unwrap().to_owned();
        let mut expected: Vec<_> = own.map(OsString::from).into_iter().chain([kept]).collect();
        expected.sort();
        assert_eq!(names(folder.path()), expected);
    }

    #[test]
    fn recordings_are_their_owners_alone_and_configs_as_the_mask_allows() {
        let folder = tempfile::tempdir().unwrap();
        let [new, replaced, shared] =
            ["new", "replaced", "shared"].map(|name| folder.path().join(name));
        fs::write(&replaced, "").unwrap();
        let by_mask = fs::metadata(&replaced).unwrap().permissions().mode();
        create(&new, text("n")).unwrap();
        replace(&replaced, text("replaced")).unwrap();
        replace_shared(&shared, text("s")).unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!([mode(&new), mode(&replaced), mode(&shared)], [0o600, 0o600, by_mask & 0o777]);
    }
}
