//! Files of a fleet that were removed while in use.

use std::fs;
use std::path::{Path, PathBuf};

use super::objects::{is_of, list};
use crate::Domain;
use crate::os::memory::SHM_DIR;

/// Removed files that a process uses.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct RemovedFiles {
    /// The process.
    pub pid: u32,
    /// One of the files.
    pub first: PathBuf,
    /// Number of these files.
    pub count: usize,
}

/// Processes of this user with open files of the domain that no longer exist. Files that a leaving
/// process has removed are excluded: connections, and frames that are only read.
pub(crate) fn removed_files(domain: &Domain) -> Vec<RemovedFiles> {
    let mut found = Vec::new();
    for process in list(Path::new("/proc")) {
        let name = process.file_name().unwrap_or_default().to_string_lossy();
        let Ok(pid) = name.parse() else { continue };
        let descriptors = list(&process.join("fd"));
        let mut removed = descriptors
            .iter()
            .filter_map(|descriptor| removed_file(domain, descriptor))
            .peekable();
        if let Some(first) = removed.peek().cloned() {
            let count = removed.count();
            found.push(RemovedFiles { pid, first, count });
        }
    }
    found
}

fn removed_file(domain: &Domain, descriptor: &Path) -> Option<PathBuf> {
    let target = fs::read_link(descriptor).ok()?;
    let path = PathBuf::from(target.to_str()?.strip_suffix(" (deleted)")?);
    let is_in_shm = path.parent() == Some(Path::new(SHM_DIR)) && is_of(domain, &path);
    let is_in_root = path.starts_with(domain.directory()) || path == domain.worker_file();
    let end = path.extension().unwrap_or_default().to_string_lossy();
    let is_needed = match &*end {
        "connection" => false,
        "data" => is_written(descriptor),
        _ => true,
    };
    ((is_in_shm || is_in_root) && is_needed).then_some(path)
}

/// True if a descriptor, given as its link in `/proc`, was opened for writing.
fn is_written(descriptor: &Path) -> bool {
    let (Some(number), Some(process)) = (
        descriptor.file_name(),
        descriptor.parent().and_then(Path::parent),
    ) else {
        return false;
    };
    let info = fs::read_to_string(process.join("fdinfo").join(number)).unwrap_or_default();
    let flags = info.lines().find_map(|line| line.strip_prefix("flags:"));
    // Octal; the last two bits are the access mode, 0 for read-only.
    let flags = flags.and_then(|flags| u32::from_str_radix(flags.trim(), 8).ok());
    flags.is_some_and(|flags| flags & 3 != 0)
}
