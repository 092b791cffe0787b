//! Memory taken and touched before it is needed.
#![allow(unsafe_code)]

use std::fs;
use std::io;
use std::path::Path;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::mm::{Advice, madvise};

use crate::domain::SHM_DIR;

/// Takes all memory of the objects in shared memory that this process has mapped for writing and
/// whose name contains `part`, and maps it now: no SIGBUS and no page fault later.
///
/// # Errors
/// `StorageFull` when it does not fit.
pub(crate) fn take(part: &str) -> io::Result<u64> {
    let maps = fs::read_to_string("/proc/self/maps")?;
    let mut bytes = 0;
    for mapping in maps.lines().filter_map(Mapping::parse) {
        if mapping.is_writable && mapping.path.contains(part) {
            mapping.take()?;
            bytes += mapping.len as u64;
        }
    }
    Ok(bytes)
}

struct Mapping<'a> {
    start: usize,
    len: usize,
    is_writable: bool,
    path: &'a str,
}

impl<'a> Mapping<'a> {
    /// A line of `/proc/self/maps`: `start-end perms offset device inode path`.
    fn parse(line: &'a str) -> Option<Self> {
        let mut words = line.split_ascii_whitespace();
        let (start, end) = words.next()?.split_once('-')?;
        let permissions = words.next()?;
        let path = words.nth(3)?;
        let start = usize::from_str_radix(start, 16).ok()?;
        let end = usize::from_str_radix(end, 16).ok()?;
        (path.starts_with(SHM_DIR)).then_some(Self {
            start,
            len: end.checked_sub(start)?,
            is_writable: permissions.starts_with("rw"),
            path,
        })
    }

    fn take(&self) -> io::Result<()> {
        let file = fs::OpenOptions::new()
            .write(true)
            .open(Path::new(self.path))?;
        let len = file.metadata()?.len();
        fallocate(&file, FallocateFlags::empty(), 0, len)?;
        // SAFETY: populating changes neither the content nor the protection of a mapping; the
        // range was just read from the list of this process's mappings, and if it has been
        // unmapped since, the call fails.
        let populated = unsafe {
            let start = std::ptr::without_provenance_mut(self.start);
            madvise(start, self.len, Advice::LinuxPopulateWrite)
        };
        if let Err(error) = populated {
            // Kernels before 5.14 cannot; then the first frames fault, and nothing worse.
            tracing::debug!(%error, path = self.path, "memory was not mapped in advance");
        }
        Ok(())
    }
}
