//! Checks that the files needed by a member are still at their paths.
//!
//! A removed file remains usable for processes that have it open, but new processes cannot open it:
//! a fleet whose files were removed continues to work and cannot be joined.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crate::os::memory::SHM_DIR;

/// The files that one member needs.
#[derive(Debug, Default)]
pub(crate) struct Presence {
    is_lost: AtomicBool,
    lost: OnceLock<PathBuf>,
    files: Mutex<Vec<NeededFile>>,
    number: AtomicU64,
}

#[derive(Debug)]
struct NeededFile {
    path: PathBuf,
    identity: Identity,
    need: u64,
}

/// Device and inode: a recreated file of the same name is another one. The length of objects in
/// shared memory never changes either.
type Identity = (u64, u64, u64);

/// Files that are needed while this value lives. To be dropped before their users.
#[derive(Debug)]
pub(crate) struct RequiredFiles {
    presence: Arc<Presence>,
    number: u64,
}

impl Presence {
    /// From now on the files at `paths` are needed.
    pub(crate) fn need(
        self: &Arc<Self>,
        paths: impl IntoIterator<Item = PathBuf>,
    ) -> RequiredFiles {
        let need = self.number.fetch_add(1, Ordering::Relaxed);
        let found = paths.into_iter().filter_map(|path| {
            let identity = identity(&path)?;
            Some(NeededFile { path, identity, need })
        });
        self.files().extend(found);
        RequiredFiles { presence: Arc::clone(self), number: need }
    }

    /// Checks all files. A missing file is reported permanently.
    pub(crate) fn look(&self) -> Result<(), FilesRemoved> {
        let files = self.files();
        if let Some(file) = files.iter().find(|file| identity(&file.path) != Some(file.identity)) {
            self.lost.get_or_init(|| file.path.clone());
            self.is_lost.store(true, Ordering::Release);
        }
        drop(files);
        self.check()
    }

    /// Result of the last check. One atomic load.
    pub(crate) fn check(&self) -> Result<(), FilesRemoved> {
        if !self.is_lost.load(Ordering::Acquire) {
            return Ok(());
        }
        Err(FilesRemoved { path: self.lost.get().cloned().unwrap_or_default() })
    }

    fn files(&self) -> MutexGuard<'_, Vec<NeededFile>> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl RequiredFiles {
    /// True if all files of the process are at their paths.
    pub(crate) fn is_met(&self) -> bool {
        self.presence.look().is_ok()
    }
}

impl Drop for RequiredFiles {
    fn drop(&mut self) {
        let number = self.number;
        self.presence.files().retain(|file| file.need != number);
    }
}

fn identity(path: &Path) -> Option<Identity> {
    let found = fs::symlink_metadata(path).ok()?;
    let is_object = path.parent() == Some(Path::new(SHM_DIR));
    let len = if is_object { found.len() } else { 0 };
    Some((found.dev(), found.ino(), len))
}

/// A file that this process uses was removed, replaced or truncated: processes started now cannot
/// open it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{path:?} was removed or cut short while this process used it: processes that start now cannot \
     reach it. End this process and start it again. A supervisor does that. If it happened when a \
     user logged out, systemd-logind did it: set `RemoveIPC=no`, or enable lingering for the user \
     (docs/how-to/removeipc.md)"
)]
pub struct FilesRemoved {
    /// The first missing file.
    pub path: PathBuf,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str) -> PathBuf {
        let name = format!("joulebus-presence-{}-{name}", std::process::id());
        std::env::temp_dir().join(name)
    }

    #[test]
    fn a_removed_or_replaced_file_is_reported_permanently_while_it_is_needed() {
        let (one, two) = (place("one"), place("two"));
        fs::write(&one, "").unwrap();
        fs::write(&two, "").unwrap();
        let presence = Arc::new(Presence::default());
        let need_one = presence.need([one.clone()]);
        let need_two = presence.need([two.clone()]);
        assert_eq!(presence.look(), Ok(()));
        fs::remove_file(&one).unwrap();
        assert_eq!(presence.check(), Ok(()), "not looked yet");
        drop(need_one);
        assert_eq!(presence.look(), Ok(()), "not needed any more");
        let replacement = place("three");
        fs::write(&replacement, "").unwrap();
        fs::rename(&replacement, &two).unwrap();
        let lost = Err(FilesRemoved { path: two.clone() });
        assert_eq!(presence.look(), lost);
        assert_eq!(presence.check(), lost);
        drop(need_two);
        assert_eq!(presence.look(), lost, "for good");
        fs::remove_file(&two).unwrap();
    }
}
