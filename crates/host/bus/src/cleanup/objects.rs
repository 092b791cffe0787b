//! The files of a domain, and open files.

use std::collections::HashSet;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use super::claim::Claim;
use crate::os::files::effective_uid;
use crate::os::memory::SHM_DIR;
use crate::{Domain, RootError, STANDBY_FILES};
use joulebus_settings::{RAISES_FILE, REFUSALS_FILE};

/// The directories that iceoryx2 creates in that of a fleet.
pub(crate) const NODES: &str = "nodes";
pub(crate) const SERVICES: &str = "services";
/// Age at which an incomplete object counts as stale. Creating one takes microseconds.
const OLD: Duration = Duration::from_millis(250);
/// An object and a node's context get this permission once complete.
pub(super) const OWNER_READ: u32 = 0o400;

/// A file of a domain, or a node's directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Object {
    pub(crate) path: PathBuf,
    pub(crate) bytes: u64,
    pub(crate) owner: u32,
    pub(crate) mode: u32,
    modified: Option<SystemTime>,
    pub(super) identity: Identity,
}

/// Device and inode: identify a file independently of its path.
pub(super) type Identity = (u64, u64);

impl Object {
    pub(super) fn new(path: PathBuf) -> Option<Self> {
        let metadata = fs::symlink_metadata(&path).ok()?;
        Self::found(path, &metadata)
    }

    pub(super) fn directory(path: PathBuf) -> Option<Self> {
        let metadata = fs::symlink_metadata(&path).ok()?;
        metadata.is_dir().then(|| Self::any(path, &metadata))
    }

    /// `None` if it is not a regular file.
    pub(super) fn found(path: PathBuf, metadata: &fs::Metadata) -> Option<Self> {
        metadata.is_file().then(|| Self::any(path, metadata))
    }

    fn any(path: PathBuf, metadata: &fs::Metadata) -> Self {
        Self {
            path,
            bytes: metadata.size(),
            owner: metadata.uid(),
            mode: metadata.mode() & 0o7777,
            modified: metadata.modified().ok(),
            identity: (metadata.dev(), metadata.ino()),
        }
    }

    /// Removes the file unless it has been changed or replaced since, or another process makes or
    /// removes it.
    pub(super) fn remove(self) -> bool {
        let Some(claim) = Claim::take(self.path.clone()) else {
            return false;
        };
        let now = claim.found().and_then(|(path, file)| Self::found(path, &file));
        now.is_some_and(|now| now == self) && claim.remove()
    }

    /// Also of a file from the future: the clock has been set back since it was made.
    pub(super) fn is_old(&self) -> bool {
        let age = |at: SystemTime| at.elapsed().unwrap_or_else(|ahead| ahead.duration());
        self.owner == effective_uid() && self.modified.is_some_and(|at| age(at) > OLD)
    }

    /// For an object in shared memory: without a size or without its final permissions.
    pub(super) fn is_incomplete(&self) -> bool {
        self.bytes == 0 || self.mode & OWNER_READ == 0
    }
}

/// All objects in shared memory with the domain's prefix, of any owner.
pub(crate) fn objects(domain: &Domain) -> Result<Vec<Object>, RootError> {
    let read = |error| RootError::io(Path::new(SHM_DIR), error);
    let mut found = Vec::new();
    for entry in fs::read_dir(SHM_DIR).map_err(read)? {
        let entry = entry.map_err(read)?;
        if is_of(domain, &entry.path()) {
            found.extend(Object::new(entry.path()));
        }
    }
    Ok(found)
}

/// The files of the domain, in all directories, whose names contain `id` and end with one of
/// `suffixes`.
pub(crate) fn named(domain: &Domain, id: &str, suffixes: &[&str]) -> Vec<PathBuf> {
    let directory = domain.directory();
    let inner = [NODES, SERVICES].map(|inner| directory.join(inner));
    let mut found = Vec::new();
    for directory in [Path::new(SHM_DIR), &directory, &inner[0], &inner[1]] {
        found.extend(list(directory).into_iter().filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let is_wanted = suffixes.iter().any(|suffix| name.ends_with(suffix));
            is_of(domain, path) && is_wanted && name.contains(id)
        }));
    }
    found
}

/// The entries of a directory of this user, which must not be a symbolic link and must be on the
/// same file system as its parent.
pub(super) fn list_own(directory: &Path) -> Vec<PathBuf> {
    let found = fs::symlink_metadata(directory);
    let above = directory.parent().map(fs::symlink_metadata);
    match (found, above) {
        (Ok(found), Some(Ok(above)))
            if found.is_dir() && found.uid() == effective_uid() && found.dev() == above.dev() =>
        {
            list(directory)
        }
        _ => Vec::new(),
    }
}

/// True if iceoryx2 uses such a name for a file of `domain`.
pub(crate) fn is_of(domain: &Domain, path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().as_encoded_bytes();
    name.starts_with(domain.shm_prefix().as_bytes())
}

/// True if a link or a worker uses such a name for a file in a fleet's directory.
pub(crate) fn is_of_worker(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    let name = name.map(|name| name.strip_suffix(".new").unwrap_or(name));
    name.is_some_and(|name| {
        STANDBY_FILES.contains(&name) || [RAISES_FILE, REFUSALS_FILE].contains(&name)
    })
}

/// True if iceoryx2 uses such a name for a node's directory.
pub(crate) fn is_of_node(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().as_encoded_bytes();
    !name.is_empty() && name.iter().all(u8::is_ascii_digit)
}

pub(crate) fn list(directory: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).collect()
}

/// All files open in processes of this user. Other users cannot open ours, which have mode 0600.
pub(super) fn open_files() -> HashSet<Identity> {
    list(Path::new("/proc"))
        .into_iter()
        .flat_map(|process| list(&process.join("fd")))
        .filter_map(|descriptor| fs::metadata(descriptor).ok())
        .map(|file| (file.dev(), file.ino()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_6_a_file_is_old_however_the_clock_was_set_since_it_was_made() {
        let path = std::env::temp_dir().join(format!("joulebus-old-{}", std::process::id()));
        let file = fs::File::create(&path).unwrap();
        let (hour, now) = (Duration::from_secs(3_600), SystemTime::now());
        for modified in [now - hour, now + hour] {
            file.set_modified(modified).unwrap();
            let object = Object::new(path.clone()).unwrap();
            assert!(object.is_old(), "{modified:?}");
        }
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_file_that_replaced_the_one_that_was_found_is_kept() {
        let path = std::env::temp_dir().join(format!("joulebus-found-{}", std::process::id()));
        fs::write(&path, "").unwrap();
        let found = Object::new(path.clone()).unwrap();
        fs::write(path.with_extension("new"), "").unwrap();
        fs::rename(path.with_extension("new"), &path).unwrap();
        assert!(!found.remove());
        assert!(Object::new(path.clone()).unwrap().remove());
        assert!(!path.exists());
    }
}
