//! The file system's operations, one by one.
//!
//! Everything that must survive a crash or a full disk is written only through this module.

use std::io;
use std::path::Path;

pub use std::fs::{File, create_dir_all, remove_file, rename};

/// Whether there is something of that name, also a link that leads nowhere.
#[must_use]
pub fn exists(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok()
}

/// Whether there is a regular file of that name itself, not through a link.
#[must_use]
pub fn is_file(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok_and(|found| found.is_file())
}

/// Writes a directory's list of names to the disk: without it a power failure may undo renames.
///
/// # Errors
/// That of the system.
pub fn sync_directory(path: &Path) -> io::Result<()> {
    File::open(path)?.sync_all()
}
