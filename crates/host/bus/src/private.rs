//! Private directories of this user, and why one is refused.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::os::files::effective_uid;

/// Checks that `path` is a directory of this user.
pub(crate) fn check_own(path: &Path) -> Result<fs::Metadata, RootError> {
    let found = fs::symlink_metadata(path).map_err(|error| RootError::io(path, error))?;
    let path = path.to_owned();
    if found.file_type().is_symlink() {
        return Err(RootError::Symlink { path });
    }
    if !found.is_dir() {
        return Err(RootError::NotADirectory { path });
    }
    let (owner, expected) = (found.uid(), effective_uid());
    if owner != expected {
        return Err(RootError::Owner { path, found: owner, expected });
    }
    Ok(found)
}

/// Checks that `path` is a directory of this user that no other user can access.
pub(crate) fn check_private(path: &Path) -> Result<(), RootError> {
    let mode = check_own(path)?.mode() & 0o7777;
    if mode & 0o077 != 0 {
        let path = path.to_owned();
        return Err(RootError::Mode { path, found: mode });
    }
    Ok(())
}

/// Reason that a root directory is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum RootError {
    /// A symbolic link could be redirected.
    #[error("{path:?} is a symbolic link. Remove it, or set `root` to the directory itself")]
    Symlink { path: PathBuf },
    /// The path is not a directory.
    #[error("{path:?} is not a directory. Remove it, or set another `root`")]
    NotADirectory { path: PathBuf },
    /// Another user owns it.
    #[error(
        "{path:?} belongs to uid {found}, expected uid {expected}: only its owner can join the \
         fleets in it. Run this as that user, have that user pass the fleet on with `joulebus \
         serve --socket PATH` or `--http ADDRESS`, or set another `root`"
    )]
    Owner { path: PathBuf, found: u32, expected: u32 },
    /// Other users can access it.
    #[error(
        "{path:?} has mode {found:04o}, allowed is 0700. Set another `root`, or, if joulebus alone \
         uses it, run `chmod 700 {}`",
        path.display()
    )]
    Mode { path: PathBuf, found: u32 },
    /// Not created by joulebus, or its marker is damaged.
    #[error(
        "{path:?} was not made by joulebus: it has no file {marker} that says so. No file in it is read, \
         changed or removed. Set another `fleet.name` or `domain.root`, or move it away. If an older \
         release made it, end that release's processes, look at what is in it, and remove it by hand"
    )]
    Unmarked { path: PathBuf, marker: &'static str },
    /// Created by joulebus for other processes.
    #[error(
        "{path:?} is in use for {found}, wanted is {wanted}: set another `domain.root`, or end those \
         processes and run `joulebus doctor --fix` with their config"
    )]
    AnotherFleet { path: PathBuf, found: String, wanted: String },
    /// The path is a mount point.
    #[error(
        "{path:?} is a mount point, which joulebus did not make. Unmount it, or set another \
         `domain.root`"
    )]
    MountPoint { path: PathBuf },
    /// The parent directory does not exist.
    #[error(
        "{path:?} cannot be made, because {parent:?} does not exist. Make it, or set another \
         `domain.root`"
    )]
    NoParent { path: PathBuf, parent: PathBuf },
    /// The system call failed.
    #[error("{path:?}: {source}")]
    Io { path: PathBuf, source: io::Error },
}

impl RootError {
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    /// True if the last member has removed the directory in the meantime.
    pub(crate) fn vanished(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

/// Conditions that work with reduced performance.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum DomainWarning {
    /// The root is on a disk: joining takes 23 ms instead of 1 ms, and a process killed during its
    /// start can leave nodes that only a cold start removes.
    NotInMemory {
        /// The root.
        root: PathBuf,
        /// The filesystem's magic number.
        filesystem: u64,
    },
}

impl std::fmt::Display for DomainWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NotInMemory { root, filesystem } => write!(
                f,
                "{root:?} is not on a tmpfs (filesystem {filesystem:#x}): starts are slower and \
                 stale files more likely. Set `root` below /dev/shm or /run/user"
            ),
        }
    }
}
