//! Allocates and maps memory before its first use.
#![allow(unsafe_code)]

use std::fs;
use std::io;
use std::os::fd::AsFd;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::{Errno, pwrite};
use rustix::mm::{Advice, madvise};

/// Directory of POSIX shared memory on Linux.
pub(crate) use joulebus_settings::SHM_DIR;
/// Maximum size of a mapping populated while ticks run, bytes: takes a few milliseconds.
const MAX_AT_ONCE: usize = 64 << 20;

/// Allocates the first `bytes` of a new file in shared memory: no SIGBUS later.
pub(crate) fn reserve(file: impl AsFd, bytes: u64) -> io::Result<()> {
    loop {
        match fallocate(&file, FallocateFlags::empty(), 0, bytes) {
            Ok(()) => return Ok(()),
            Err(Errno::INTR) => {}
            // Not every sandbox and file system has it.
            Err(Errno::OPNOTSUPP | Errno::NOSYS | Errno::PERM) => return write_zeros(&file, bytes),
            Err(error) => return Err(error.into()),
        }
    }
}

/// Takes the pages of a new file by writing what they contain.
fn write_zeros(file: impl AsFd, bytes: u64) -> io::Result<()> {
    let zeros = [0; 4_096];
    let mut written = 0;
    while written < bytes {
        let piece = (bytes - written).min(zeros.len() as u64) as usize;
        match pwrite(&file, &zeros[..piece], written) {
            Ok(count) => written += count as u64,
            Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
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
/// process reads: no page fault later. Best effort. Mappings over 64 MiB are left to page faults,
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
        // SAFETY: populating changes neither the contents nor the protection of a mapping. The
        // range was just read from the list of this process's mappings, and if it has been unmapped
        // since, the call fails.
        let populated = unsafe {
            let start = std::ptr::without_provenance_mut(self.start);
            madvise(start, self.len, advice)
        };
        if let Err(error) = populated {
            // Not supported by kernels before 5.14. The first frames then cause page faults,
            // nothing worse.
            tracing::debug!(%error, path = self.path, "memory was not mapped in advance");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{MemfdFlags, fstat, memfd_create};

    #[test]
    fn pages_are_taken_where_there_is_no_call_for_it() {
        let new = || memfd_create("joulebus-test", MemfdFlags::CLOEXEC).unwrap();
        let (by_call, by_zeros) = (new(), new());
        reserve(&by_call, 10_000).unwrap();
        write_zeros(&by_zeros, 10_000).unwrap();
        let taken = |file| fstat(file).map(|found| (found.st_size, found.st_blocks)).unwrap();
        assert_eq!(taken(&by_zeros), taken(&by_call));
        assert!(taken(&by_zeros).1 * 512 >= 10_000);
    }
}
