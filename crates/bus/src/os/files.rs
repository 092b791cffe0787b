//! Owners, identities and file systems of files.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

const TMPFS: u64 = 0x0102_1994;
const RAMFS: u64 = 0x8584_58f6;

pub(crate) fn effective_uid() -> u32 {
    rustix::process::geteuid().as_raw()
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
