//! Allocates and maps memory before its first use.
#![allow(unsafe_code)]

use std::fs;
use std::io;
use std::os::fd::AsFd;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;
use rustix::mm::{Advice, madvise};

/// Directory of POSIX shared memory on Linux.
pub(crate) use joulebus_domain::SHM_DIR;
/// Maximum size of a mapping populated while ticks run, bytes: takes a few milliseconds.
const MAX_AT_ONCE: usize = 64 << 20;

/// Allocates the first `bytes` of a file in shared memory, all or none: no SIGBUS later.
///
/// # Errors
/// `StorageFull` if they do not fit.
pub(crate) fn reserve(file: impl AsFd, bytes: u64) -> io::Result<()> {
    loop {
        match fallocate(&file, FallocateFlags::empty(), 0, bytes) {
            // A file system without a limit.
            Ok(()) | Err(Errno::OPNOTSUPP) => return Ok(()),
            Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
}

/// Populates the mappings of the shared-memory objects whose name contains `part` and that this
/// process writes: no page fault later. Best effort.
pub(crate) fn populate(part: &str) {
    let Ok(maps) = fs::read_to_string("/proc/self/maps") else {
        return;
    };
    for mapping in maps.lines().filter_map(Mapping::parse) {
        if mapping.is_writable && mapping.is_shared() && mapping.path.contains(part) {
            mapping.populate(Advice::LinuxPopulateWrite);
        }
    }
}

/// Populates the mappings of the shared-memory objects whose name contains `part` and that this
/// process reads: no page fault later. Best effort; mappings over 64 MiB are left to page faults,
/// because populating them would take longer than a frame may.
pub(crate) fn map(part: &str) {
    let Ok(maps) = fs::read_to_string("/proc/self/maps") else {
        return;
    };
    let of_part = |mapping: &Mapping<'_>| {
        mapping.is_shared() && mapping.path.contains(part) && mapping.len <= MAX_AT_ONCE
    };
    for mapping in maps.lines().filter_map(Mapping::parse).filter(of_part) {
        mapping.populate(Advice::LinuxPopulateRead);
    }
}

/// Touches all private memory of this process, including allocated but unused memory, so that its
/// first use causes no page fault: about 0.2 s per GiB. Call it after all large allocations, and
/// before starting threads, whose stacks would be touched too. Best effort: not supported by
/// kernels before 5.14.
pub fn touch_own_memory() {
    let Ok(maps) = fs::read_to_string("/proc/self/maps") else {
        return;
    };
    for mapping in maps.lines().filter_map(Mapping::parse) {
        if mapping.is_writable && matches!(mapping.path, "" | "[heap]") {
            mapping.populate(Advice::LinuxPopulateWrite);
        }
    }
}

struct Mapping<'a> {
    start: usize,
    len: usize,
    is_writable: bool,
    /// Empty for anonymous memory.
    path: &'a str,
}

impl<'a> Mapping<'a> {
    /// A line of `/proc/self/maps`: `start-end perms offset device inode path`.
    fn parse(line: &'a str) -> Option<Self> {
        let mut words = line.split_ascii_whitespace();
        let (start, end) = words.next()?.split_once('-')?;
        let permissions = words.next()?;
        let path = words.nth(3).unwrap_or_default();
        let start = usize::from_str_radix(start, 16).ok()?;
        let end = usize::from_str_radix(end, 16).ok()?;
        Some(Self {
            start,
            len: end.checked_sub(start)?,
            is_writable: permissions.starts_with("rw"),
            path,
        })
    }

    fn is_shared(&self) -> bool {
        self.path.starts_with(SHM_DIR)
    }

    fn populate(&self, advice: Advice) {
        // SAFETY: populating changes neither the contents nor the protection of a mapping; the
        // range was just read from the list of this process's mappings, and if it has been unmapped
        // since, the call fails.
        let populated = unsafe {
            let start = std::ptr::without_provenance_mut(self.start);
            madvise(start, self.len, advice)
        };
        if let Err(error) = populated {
            // Not supported by kernels before 5.14; the first frames then cause page faults,
            // nothing worse.
            tracing::debug!(%error, path = self.path, "memory was not mapped in advance");
        }
    }
}
