//! The id of this process, without a system call.
#![allow(unsafe_code)]

use std::ptr;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

use super::fork::ForkSection;
use rustix::mm::{Advice, MapFlags, ProtFlags, madvise, mmap_anonymous, munmap};

/// The id of this process. The kernel is asked once in each process, because each call of C checks
/// that it is still in the process that opened its handle.
#[must_use]
pub fn process_id() -> u32 {
    static KNOWN: OnceLock<Option<&'static AtomicU32>> = OnceLock::new();
    let known = KNOWN.get().or_else(|| {
        let _section = ForkSection::enter();
        Some(KNOWN.get_or_init(emptied_by_fork))
    });
    let Some(Some(known)) = known else {
        return std::process::id();
    };
    match known.load(Ordering::Relaxed) {
        0 => {
            let id = std::process::id();
            known.store(id, Ordering::Relaxed);
            id
        }
        id => id,
    }
}

/// A number that is 0, and is 0 again in each process forked from this one. `None` where the kernel
/// has no such memory (before Linux 4.14, and emulators).
fn emptied_by_fork() -> Option<&'static AtomicU32> {
    let length = rustix::param::page_size();
    let (protection, flags) = (ProtFlags::READ | ProtFlags::WRITE, MapFlags::PRIVATE);
    // SAFETY: new memory, at an address that the kernel chooses.
    let page = unsafe { mmap_anonymous(ptr::null_mut(), length, protection, flags) }.ok()?;
    // SAFETY: the page that was just made: nothing refers to it yet.
    if unsafe { madvise(page, length, Advice::LinuxWipeOnFork) }.is_err() {
        // SAFETY: as above.
        let _ = unsafe { munmap(page, length) };
        return None;
    }
    // SAFETY: a page of zeros, aligned, never unmapped, and only used through this reference.
    Some(unsafe { &*page.cast::<AtomicU32>() })
}

#[cfg(test)]
mod tests {
    use super::*;

    // In a forked process: `cargo test -p joulebus-c --test all programs`, misuse.c.
    #[test]
    fn it_is_that_of_the_kernel() {
        for _ in 0..3 {
            assert_eq!(process_id(), std::process::id());
        }
        let known = emptied_by_fork().expect("this kernel has such memory");
        assert_eq!(known.load(Ordering::Relaxed), 0);
    }
}
