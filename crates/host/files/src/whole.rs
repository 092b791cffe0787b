//! Files that appear when they are whole: a program that fails, or is killed, leaves none of them
//! half written.

use std::fs::File;
use std::io;
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Mode, OFlags, RenameFlags, linkat, open, renameat_with};
use rustix::io::Errno;

use crate::{Refused, disk, look};

/// Permissions before the user's mask.
const MODE: u32 = 0o666;
/// Maximum number of bytes that identify the kind of a file.
const MAX_KIND_BYTES: usize = 9;
const MAGIC_BYTES: usize = 4;
/// Maximum number of temporary names tried beside the target.
const MAX_NAMES: u32 = 1_000;

/// Writes a new file at `path`. Nothing may exist there, not even a dangling link.
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
    let draft = Draft::begin(path)?;
    let written = write(&draft.file)?;
    draft.link(path)?;
    Ok(written)
}

/// Writes a file at `path`, and replaces the file of an earlier run: a regular file that is empty
/// or begins like the new one. A link is replaced, not followed.
///
/// # Errors
/// [`Refused::Kind`](crate::Refused::Kind) for a pipe, a device, a directory or a link to one.
/// [`Refused::Foreign`](crate::Refused::Foreign). Errors of the system and of `write`.
pub fn replace<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&File) -> Result<T, E>,
) -> Result<T, E> {
    match look(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
        _ => {}
    }
    let draft = Draft::begin(path)?;
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

fn taken() -> io::Error {
    let what = "the file exists and is not overwritten. Name another";
    io::Error::new(io::ErrorKind::AlreadyExists, what)
}

/// A file that is being written.
///
/// It has no name, so the system removes it however the program ends. If the file system cannot do
/// that, it has a hidden name beside its target, which is removed when the draft is dropped.
#[derive(Debug)]
pub(crate) struct Draft {
    file: File,
    hidden: Option<PathBuf>,
}

impl Drop for Draft {
    fn drop(&mut self) {
        if let Some(hidden) = &self.hidden {
            // Any remains are hidden and named after this process.
            let _ = disk::remove_file(hidden);
        }
    }
}

impl Draft {
    /// Begins the file for `path`.
    pub(crate) fn begin(path: &Path) -> io::Result<Self> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
        match open(folder.unwrap_or(Path::new(".")), flags, Mode::from_raw_mode(MODE)) {
            Ok(file) => Ok(Self { file: file.into(), hidden: None }),
            Err(Errno::OPNOTSUPP | Errno::ISDIR | Errno::INVAL) => Self::begin_named(path),
            Err(error) => Err(error.into()),
        }
    }

    fn begin_named(path: &Path) -> io::Result<Self> {
        let (file, hidden) = beside(path, |hidden| {
            File::options().read(true).write(true).create_new(true).open(hidden)
        })?;
        Ok(Self { file, hidden: Some(hidden) })
    }

    pub(crate) const fn file(&self) -> &File {
        &self.file
    }

    /// Gives the file its name, and replaces one of an earlier run, which begins like it.
    pub(crate) fn replace(self, path: &Path) -> io::Result<()> {
        let mut beginning = [0; MAX_KIND_BYTES];
        let length = self.file.read_at(&mut beginning, 0)?;
        check_kind(path, &beginning[..length])?;
        self.rename(path)
    }

    /// Gives the file its name, which must be free.
    pub(crate) fn link(mut self, path: &Path) -> io::Result<()> {
        let Some(hidden) = &self.hidden else {
            return self.name(path);
        };
        match renameat_with(CWD, hidden, CWD, path, RenameFlags::NOREPLACE) {
            Ok(()) => self.hidden = None,
            // Linking fails if the name is taken. The hidden name is removed with the draft.
            Err(Errno::INVAL | Errno::NOSYS) => std::fs::hard_link(hidden, path)?,
            Err(Errno::EXIST) => return Err(taken()),
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    /// Gives the file its name, and replaces the file that has it.
    fn rename(mut self, path: &Path) -> io::Result<()> {
        // A power failure must not leave a part of it in the place of the file before.
        self.file.sync_all()?;
        let hidden = match self.hidden.take() {
            Some(hidden) => hidden,
            None => beside(path, |hidden| self.name(hidden))?.1,
        };
        let renamed = disk::rename(&hidden, path);
        if renamed.is_err() {
            self.hidden = Some(hidden);
        }
        renamed
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

/// Creates a file under a free hidden name beside `path`.
pub(crate) fn beside<T>(
    path: &Path,
    mut make: impl FnMut(&Path) -> io::Result<T>,
) -> io::Result<(T, PathBuf)> {
    let mut number = 0;
    loop {
        // Not after the file, whose name may be as long as names may be.
        let name = format!(".joulebus-{}-{number}", std::process::id());
        let hidden = path.with_file_name(name);
        match make(&hidden) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && number < MAX_NAMES => {
                number += 1;
            }
            made => return Ok((made?, hidden)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::fs;
    use std::io::Write as _;
    use std::os::unix::fs::symlink;

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
            let draft = Draft::begin_named(&path).unwrap();
            text("it")(&draft.file).unwrap();
            draft
        };
        drop(begin());
        assert!(names(folder.path()).is_empty());
        begin().link(&path).unwrap();
        assert!(begin().link(&path).is_err());
        fs::write(&path, "before").unwrap();
        let (one, two) = (begin(), begin());
        one.rename(&path).unwrap();
        two.rename(&path).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "it");
        assert!(begin().rename(&folder.path().join("no/such/folder")).is_err());
        assert_eq!(names(folder.path()), ["out"]);
    }
}
