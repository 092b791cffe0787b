//! Owners, identities and file systems of files.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

const TMPFS: u64 = 0x0102_1994;
const RAMFS: u64 = 0x8584_58f6;

pub(crate) fn effective_uid() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// A number for the name of a temporary file, different at every call: threads of one process may
/// write the same file at the same time.
pub(crate) fn draft_number() -> u32 {
    static DRAFTS: AtomicU32 = AtomicU32::new(0);
    DRAFTS.fetch_add(1, Ordering::Relaxed)
}

/// True if `path` still refers to `file`.
pub(crate) fn is_same(file: &File, path: &Path) -> io::Result<bool> {
    let held = file.metadata()?;
    match fs::symlink_metadata(path) {
        Ok(there) => Ok(held.ino() == there.ino() && held.dev() == there.dev()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

pub(crate) fn filesystem(path: &Path) -> io::Result<u64> {
    let found = rustix::fs::statfs(path)?;
    #[allow(clippy::unnecessary_cast, reason = "the width depends on the platform")]
    Ok(found.f_type as u64)
}

pub(crate) fn is_memory(filesystem: u64) -> bool {
    filesystem == TMPFS || filesystem == RAMFS
}
