//! Files of a fleet that were removed while in use.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

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

/// Time within which the processes of a fleet settle. They hold the events of a reader that has
/// left until their next look at who is there.
pub(super) const SETTLES_WITHIN: Duration = Duration::from_millis(2_500);

/// Processes of this user with open files of the domain that no longer exist, so that processes
/// started now cannot reach them. Excluded are files that a leaving process has removed:
/// connections, frames that are only read, and what is closed within 2.5 s, for which this waits.
#[must_use]
pub fn removed_files(domain: &Domain) -> Vec<RemovedFiles> {
    let before = in_use(domain);
    if before.is_empty() {
        return Vec::new();
    }
    std::thread::sleep(SETTLES_WITHIN);
    let mut found: Vec<RemovedFiles> = Vec::new();
    for (pid, path) in in_use(domain).intersection(&before) {
        match found.last_mut().filter(|last| last.pid == *pid) {
            Some(last) => last.count += 1,
            None => found.push(RemovedFiles { pid: *pid, first: path.clone(), count: 1 }),
        }
    }
    found
}

/// Removed files and the processes that have them open.
fn in_use(domain: &Domain) -> BTreeSet<(u32, PathBuf)> {
    let mut found = BTreeSet::new();
    for process in list(Path::new("/proc")) {
        let name = process.file_name().unwrap_or_default().to_string_lossy();
        let Ok(pid) = name.parse() else { continue };
        let descriptors = list(&process.join("fd"));
        let removed = descriptors.iter().filter_map(|descriptor| removed_file(domain, descriptor));
        found.extend(removed.map(|path| (pid, path)));
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
    let (Some(number), Some(process)) =
        (descriptor.file_name(), descriptor.parent().and_then(Path::parent))
    else {
        return false;
    };
    let info = fs::read_to_string(process.join("fdinfo").join(number)).unwrap_or_default();
    let flags = info.lines().find_map(|line| line.strip_prefix("flags:"));
    // Octal. The last two bits are the access mode, 0 for read-only.
    let flags = flags.and_then(|flags| u32::from_str_radix(flags.trim(), 8).ok());
    flags.is_some_and(|flags| flags & 3 != 0)
}
