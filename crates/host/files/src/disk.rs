//! The file system's operations, one by one.
//!
//! Everything that must survive a crash or a full disk is written only through this module.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

pub use std::fs::{File, remove_file, rename};

/// True if there is something of that name, also a link that leads nowhere.
#[must_use]
pub fn exists(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok()
}

/// True if there is a regular file of that name itself, not through a link.
#[must_use]
pub fn is_file(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok_and(|found| found.is_file())
}

/// Writes a directory's list of names to the disk: without it a power failure may undo renames.
///
/// # Errors
/// The system's error.
pub fn sync_directory(path: &Path) -> io::Result<()> {
    File::open(path)?.sync_all()
}

/// Creates a directory with its missing parents, and writes the name of each to the disk: without
/// that a power failure may undo a whole directory, whatever was synced in it.
///
/// # Errors
/// The system's error.
pub fn create_dir_all(path: impl AsRef<Path>) -> io::Result<()> {
    create_synced(path.as_ref(), |parent| match sync_directory(parent) {
        // It may be written and not read, so it cannot be synced.
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Ok(()),
        synced => synced,
    })
}

fn create_synced(path: &Path, mut sync: impl FnMut(&Path) -> io::Result<()>) -> io::Result<()> {
    let missing = |path: &&Path| !path.as_os_str().is_empty() && !path.is_dir();
    let missing: Vec<PathBuf> = path.ancestors().take_while(missing).map(Path::to_owned).collect();
    std::fs::create_dir_all(path)?;
    for made in missing {
        let parent = made.parent().filter(|parent| !parent.as_os_str().is_empty());
        sync(parent.unwrap_or(Path::new(".")))?;
    }
    Ok(())
}

/// Identity of a file, whatever its name: device and inode.
pub type FileId = (u64, u64);

/// Mode of what tells where robots were: its owner's alone, whatever the mask.
const PRIVATE: u32 = 0o600;

/// Creates a private file whose every write goes to its end.
///
/// # Errors
/// There is one, or that of the system.
pub fn create_to_append(path: &Path) -> io::Result<File> {
    File::options().append(true).create_new(true).mode(PRIVATE).open(path)
}

/// Creates a private file, or empties the one that is there.
///
/// # Errors
/// The system's error.
pub fn create(path: &Path) -> io::Result<File> {
    File::options().write(true).create(true).truncate(true).mode(PRIVATE).open(path)
}

/// Creates a private file.
///
/// # Errors
/// There is one, or that of the system.
pub fn create_new(path: &Path) -> io::Result<File> {
    File::options().write(true).create_new(true).mode(PRIVATE).open(path)
}

/// Makes a file its owner's alone.
///
/// # Errors
/// The system's error.
pub fn make_private(file: &File) -> io::Result<()> {
    file.set_permissions(Permissions::from_mode(PRIVATE))
}

/// The id of an open file.
///
/// # Errors
/// The system's error.
pub fn id(file: &File) -> io::Result<FileId> {
    file.metadata().map(|found| (found.dev(), found.ino()))
}

/// The file of that name and its length. `None` if there is none.
///
/// # Errors
/// The system's error.
pub fn found_at(path: &Path) -> io::Result<Option<(FileId, u64)>> {
    match std::fs::metadata(path) {
        Ok(found) => Ok(Some(((found.dev(), found.ino()), found.len()))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Version of a file, to distinguish it from one that has replaced it: inode, and time of
/// modification.
pub type Version = (u64, i64, i64);

/// The version of the file of that name.
///
/// # Errors
/// The system's error.
pub fn version(path: &Path) -> io::Result<Version> {
    std::fs::metadata(path)
        .map(|metadata| (metadata.ino(), metadata.mtime(), metadata.mtime_nsec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parent_of_each_new_directory_is_synced_and_of_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for (made, expected) in [
            ("a/b/c", vec![at("a/b"), at("a"), at("")]),
            ("a/b/c", vec![]),
            ("a/b/d/", vec![at("a/b")]),
        ] {
            let mut synced = Vec::new();
            let note = |path: &Path| {
                synced.push(path.to_owned());
                Ok(())
            };
            create_synced(&at(made), note).unwrap();
            assert!(at(made).is_dir());
            assert_eq!(synced, expected, "{made}");
        }
        let failing = |_: &Path| Err(io::ErrorKind::StorageFull.into());
        assert!(create_synced(&at("e"), failing).is_err());
        create_dir_all(at("f/g")).unwrap();
        std::fs::write(at("file"), "").unwrap();
        assert!(create_dir_all(at("file/h")).is_err());
    }

    #[test]
    fn files_that_tell_where_robots_were_are_their_owners_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let public = File::create(path("copied")).unwrap();
        make_private(&public).unwrap();
        for file in [
            create_to_append(&path("capture")).unwrap(),
            create(&path("state")).unwrap(),
            create_new(&path("ledger")).unwrap(),
            public,
        ] {
            assert_eq!(file.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        }
        assert!(create_new(&path("ledger")).is_err());
    }
}
