//! Directories created by joulebus. Each contains a marker. Those without one belong to others and
//! are neither changed nor removed, unless iceoryx2 alone made them (`adopt.rs`).

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rustix::fs::{AtFlags, CWD, Mode, OFlags, RenameFlags, fchmod, linkat, openat, renameat_with};
use rustix::io::Errno;

use crate::os::files::{draft_number, effective_uid, is_same};
use crate::os::fork::ForkSection;
use crate::os::process::is_alive;
use crate::private::{check_own, check_private};
use crate::{Domain, RootError, clock};
use joulebus_settings::FLEET_MARKER;

pub(crate) const ROOT_MARKER: &str = ".joulebus";
/// Prefix of every marker.
const FIRST_LINE: &str = "joulebus directory 1\n";
/// Maximum number of bytes read from a marker.
const MAX_BYTES: u64 = 512;
/// Name prefixes of directories being created and being removed.
const ASIDE: [&str; 2] = ["new", "gone"];

/// Held while a directory is created or removed: the temporary directories with our process id are
/// then not those of another thread.
static IN_PROGRESS: Mutex<()> = Mutex::new(());

/// Takes [`IN_PROGRESS`], in a section in which no other thread forks.
fn in_progress() -> (MutexGuard<'static, ()>, ForkSection) {
    let section = ForkSection::enter();
    // Dropped in this order.
    (IN_PROGRESS.lock().unwrap_or_else(PoisonError::into_inner), section)
}

/// A directory of joulebus, existing or not.
#[derive(Debug)]
pub(crate) struct Marked {
    path: PathBuf,
    marker: &'static str,
    /// Contents of the marker, without the boot.
    contents: String,
}

impl Marked {
    /// The root of `domain`. One without a marker may be used, but is not removed.
    pub(crate) fn root(domain: &Domain) -> Self {
        Self {
            path: domain.root().to_owned(),
            marker: ROOT_MARKER,
            contents: format!("{FIRST_LINE}root\n"),
        }
    }

    pub(crate) fn fleet(domain: &Domain) -> Self {
        let (fleet, prefix) = (domain.fleet(), domain.shm_prefix());
        Self {
            path: domain.directory(),
            marker: FLEET_MARKER,
            contents: format!("{FIRST_LINE}fleet {fleet}\nprefix {prefix}\n"),
        }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Creates the directory, unless its path exists. It appears there with its marker atomically:
    /// a process killed in the meantime leaves a temporary directory under another name.
    pub(crate) fn create(&self) -> Result<(), RootError> {
        let _guard = in_progress();
        self.remove_drafts();
        let draft = self.aside(ASIDE[0]);
        let made = fs::DirBuilder::new()
            .mode(0o700)
            .create(&draft)
            .and_then(|()| self.write_marker(&draft))
            .and_then(|()| rename(&draft, &self.path));
        let Err(error) = made else { return Ok(()) };
        self.discard(&draft);
        if error.kind() == ErrorKind::AlreadyExists {
            return Ok(());
        }
        Err(RootError::io(&self.path, error))
    }

    /// The boot in which the directory was created, if it is private and contains our marker.
    pub(crate) fn check(&self) -> Result<String, RootError> {
        // The marker is checked first: the mode of others' directories must not be changed.
        check_own(&self.path)?;
        let directory = open_directory(&self.path).map_err(|e| RootError::io(&self.path, e))?;
        let boot = self.read_marker(&directory)?;
        check_private(&self.path)?;
        Ok(boot)
    }

    /// Removes other users' rights, if the directory is ours. Returns the previous mode if it was
    /// changed.
    pub(crate) fn restrict(&self) -> Result<Option<u32>, RootError> {
        let Ok(directory) = open_directory(&self.path) else {
            // Missing, or not ours: `check` reports it.
            return Ok(None);
        };
        let failed = |error| RootError::io(&self.path, error);
        let found = directory.metadata().map_err(failed)?;
        let mode = found.mode() & 0o7777;
        if found.uid() != effective_uid() || mode & 0o077 == 0 {
            return Ok(None);
        }
        self.read_marker(&directory)?;
        fchmod(&directory, Mode::RWXU).map_err(|error| failed(error.into()))?;
        Ok(Some(mode))
    }

    /// Makes a directory without a marker one of joulebus: private, then marked. Returns its
    /// previous mode. The caller knows that it is of this domain.
    pub(crate) fn adopt(&self) -> Result<u32, RootError> {
        let mode = check_own(&self.path)?.mode() & 0o7777;
        let failed = |error| RootError::io(&self.path, error);
        let directory = open_directory(&self.path).map_err(failed)?;
        if is_same(&directory, &self.path).map_err(failed)? {
            fchmod(&directory, Mode::RWXU).map_err(|error| failed(error.into()))?;
            self.restore(&directory).map_err(failed)?;
        }
        Ok(mode)
    }

    /// Removes the directory if it is ours and contains only its marker. The caller knows that no
    /// process uses it. Atomic for other processes.
    pub(crate) fn remove(&self) {
        let _guard = in_progress();
        self.remove_drafts();
        if self.check().is_err() || !self.holds_nothing(&self.path) {
            return;
        }
        let aside = self.aside(ASIDE[1]);
        if rename(&self.path, &aside).is_err() {
            return;
        }
        if self.holds_nothing(&aside) {
            self.discard(&aside);
        } else {
            // A file was created in it in the meantime.
            let _ = rename(&aside, &self.path);
        }
    }

    /// Restores a removed marker in `directory`, so that the directory can be cleaned up. Locks on
    /// the removed marker have no effect any more. It appears complete, or not at all. Nothing
    /// changes if there is a marker.
    ///
    /// # Errors
    /// The directory is gone, or the file cannot be written.
    pub(crate) fn restore(&self, directory: &File) -> io::Result<()> {
        let flags = OFlags::WRONLY | OFlags::TMPFILE | OFlags::CLOEXEC;
        let file = File::from(openat(directory, ".", flags, Mode::RUSR | Mode::WUSR)?);
        self.write(&file)?;
        let unnamed = format!("/proc/self/fd/{}", file.as_raw_fd());
        match linkat(CWD, unnamed, directory, self.marker, AtFlags::SYMLINK_FOLLOW) {
            Ok(()) | Err(Errno::EXIST) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    fn write_marker(&self, directory: &Path) -> io::Result<()> {
        let file = fs::OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(directory.join(self.marker))?;
        self.write(&file)
    }

    fn write(&self, mut file: &File) -> io::Result<()> {
        file.write_all(format!("{}boot {}\n", self.contents, this_boot()).as_bytes())?;
        file.sync_all()
    }

    fn read_marker(&self, directory: &File) -> Result<String, RootError> {
        let failed = |error| RootError::io(&self.path, error);
        let unmarked = || RootError::Unmarked { path: self.path.clone(), marker: self.marker };
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = match openat(directory, self.marker, flags, Mode::empty()) {
            Ok(file) => File::from(file),
            // Another process has just removed the directory.
            Err(Errno::NOENT) if !is_same(directory, &self.path).map_err(failed)? => {
                return Err(failed(ErrorKind::NotFound.into()));
            }
            // Missing, a link, a socket, or unreadable for us.
            Err(Errno::NOENT | Errno::LOOP | Errno::NXIO | Errno::ACCESS) => {
                return Err(unmarked());
            }
            Err(error) => return Err(failed(error.into())),
        };
        let text = own_text(file).map_err(failed)?.ok_or_else(unmarked)?;
        if let Some(rest) = text.strip_prefix(&self.contents) {
            let boot = rest.strip_prefix("boot ").and_then(|id| id.strip_suffix('\n'));
            return Ok(boot.ok_or_else(unmarked)?.to_owned());
        }
        let Some(found) = text.strip_prefix(FIRST_LINE) else {
            return Err(unmarked());
        };
        let found = found.lines().take(2).collect::<Vec<_>>().join(", ");
        Err(RootError::AnotherFleet {
            path: self.path.clone(),
            found,
            wanted: self.contents.lines().skip(1).collect::<Vec<_>>().join(", "),
        })
    }

    fn holds_nothing(&self, directory: &Path) -> bool {
        let Ok(mut entries) = fs::read_dir(directory) else {
            return false;
        };
        entries.all(|entry| entry.is_ok_and(|entry| entry.file_name() == self.marker))
    }

    /// A name beside the directory, unique to this process.
    fn aside(&self, kind: &str) -> PathBuf {
        let number = draft_number();
        let (name, pid) = (self.name(), std::process::id());
        self.path.with_file_name(format!(".{name}.{kind}-{pid}-{number}"))
    }

    fn name(&self) -> &str {
        // `Domain::new` has checked the path: it has a last component, in ASCII.
        let name = self.path.file_name().and_then(|name| name.to_str());
        name.unwrap_or_default()
    }

    /// Removes temporary directories of killed processes.
    fn remove_drafts(&self) {
        let begin = format!(".{}.", self.name());
        let parent = self.path.parent().unwrap_or(Path::new("/"));
        for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let rest = name.to_str().and_then(|name| name.strip_prefix(&begin));
            if rest.and_then(maker).is_some_and(has_ended) {
                self.discard(&entry.path());
            }
        }
    }

    /// Removes a temporary directory: one that contains at most a marker, possibly truncated.
    fn discard(&self, draft: &Path) {
        let is_ours = fs::symlink_metadata(draft)
            .is_ok_and(|found| found.is_dir() && found.uid() == effective_uid());
        if !is_ours {
            return;
        }
        let marker = draft.join(self.marker);
        let is_marker = open_regular(&marker)
            .and_then(own_text)
            .unwrap_or_default()
            .is_some_and(|text| text.starts_with(FIRST_LINE) || FIRST_LINE.starts_with(&text));
        if is_marker {
            let _ = fs::remove_file(&marker);
        }
        // Fails if it contains anything else.
        let _ = fs::remove_dir(draft);
    }
}

/// The current boot, as written in markers.
pub(crate) fn this_boot() -> String {
    clock::boot_id().unwrap_or_else(|_| "unknown".to_owned())
}

/// Process that created a temporary directory, by the suffix of its name: `new-<pid>-<number>`.
fn maker(rest: &str) -> Option<u32> {
    let (kind, rest) = rest.split_once('-')?;
    let (pid, number) = rest.split_once('-')?;
    number.parse::<u32>().ok()?;
    ASIDE.contains(&kind).then_some(pid.parse().ok()?)
}

/// One with our pid is of an earlier process, or of a failed attempt.
fn has_ended(pid: u32) -> bool {
    pid == std::process::id() || !is_alive(pid)
}

/// The text of a regular file that only this user can write. `None` of any other.
fn own_text(file: File) -> io::Result<Option<String>> {
    let found = file.metadata()?;
    if !found.is_file() || found.uid() != effective_uid() || found.mode() & 0o022 != 0 {
        return Ok(None);
    }
    let mut text = Vec::new();
    file.take(MAX_BYTES).read_to_end(&mut text)?;
    Ok(String::from_utf8(text).ok())
}

fn open_regular(path: &Path) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    fs::OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path)
}

pub(crate) fn open_directory(path: &Path) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::DIRECTORY;
    fs::OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path)
}

/// Never replaces an existing path, not even an empty directory.
fn rename(from: &Path, to: &Path) -> io::Result<()> {
    Ok(renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE)?)
}
