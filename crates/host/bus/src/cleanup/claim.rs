//! The right to remove a file whose name another file may get.
//!
//! Names of services and the node counter's are used again: what a slow process found under one may
//! have been removed and made anew. So a file is removed by the process alone that has its inode
//! locked and has seen that the path still leads to it. The kernel gives a lock back when its
//! holder ends, and nobody waits for one.

use std::fs::{self, File};
use std::io::Read as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::PathBuf;

use rustix::fs::{FlockOperation, OFlags, flock};

use crate::os::files::is_same;

/// The lock of a file: nobody else removes it.
#[derive(Debug)]
pub(crate) struct Claim {
    file: File,
    path: PathBuf,
}

impl Claim {
    /// `None` if there is no file, or another process has claimed it.
    pub(crate) fn take(path: PathBuf) -> Option<Self> {
        let open = |write: bool| {
            fs::OpenOptions::new()
                .read(!write)
                .write(write)
                .custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed())
                .open(&path)
        };
        // Incomplete objects may only be written.
        let file = open(false).or_else(|_| open(true)).ok()?;
        flock(&file, FlockOperation::NonBlockingLockExclusive).ok()?;
        let claim = Self { file, path };
        is_same(&claim.file, &claim.path).ok()?.then_some(claim)
    }

    /// The path and the metadata of the claimed file.
    pub(super) fn found(&self) -> Option<(PathBuf, fs::Metadata)> {
        Some((self.path.clone(), self.file.metadata().ok()?))
    }

    /// The contents of the file. None if it is no text, or may only be written.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        let _ = (&self.file).read_to_string(&mut text);
        text
    }

    /// Returns whether the file was removed.
    pub(crate) fn remove(self) -> bool {
        fs::remove_file(&self.path).is_ok()
    }
}

impl Drop for Claim {
    /// A child made by `fork` has a copy of the descriptor: closing this one would not unlock.
    fn drop(&mut self) {
        let _ = flock(&self.file, FlockOperation::Unlock);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_process_at_a_time_claims_a_file() {
        let path = std::env::temp_dir().join(format!("joulebus-claim-{}", std::process::id()));
        fs::write(&path, "").unwrap();
        let claim = Claim::take(path.clone()).unwrap();
        assert!(Claim::take(path.clone()).is_none());
        // As a child made by `fork` has one.
        let copy = claim.file.try_clone().unwrap();
        drop(claim);
        assert!(Claim::take(path.clone()).is_some());
        drop(copy);
        fs::remove_file(&path).unwrap();
    }
}
