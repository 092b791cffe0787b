//! An allocator that counts the allocations of the calling thread, for the tests of all crates that
//! guarantee allocation-free code. A test binary that reads the counts installs it:
//!
//! ```
//! #[global_allocator]
//! static ALLOCATOR: joulebus_testkit::counting::Counting = joulebus_testkit::counting::Counting;
//! ```
#![allow(unsafe_code, reason = "a global allocator requires unsafe code")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    /// Calls and bytes of this thread only: keepers, checkpointers and other tests run in parallel.
    static CALLS: Cell<u64> = const { Cell::new(0) };
    static BYTES: Cell<u64> = const { Cell::new(0) };
    /// Bytes allocated now, and their maximum.
    static LIVE: Cell<i64> = const { Cell::new(0) };
    static PEAK: Cell<i64> = const { Cell::new(0) };
}

/// The system's allocator, counted.
#[derive(Debug)]
pub struct Counting;

fn count(bytes: usize) {
    // Fails only while the thread's locals are destroyed.
    let _ = CALLS.try_with(|calls| calls.set(calls.get() + 1));
    let _ = BYTES.try_with(|total| total.set(total.get() + bytes as u64));
    hold(bytes as i64);
}

fn hold(bytes: i64) {
    let Ok(live) = LIVE.try_with(|live| {
        live.set(live.get() + bytes);
        live.get()
    }) else {
        return;
    };
    let _ = PEAK.try_with(|peak| peak.set(peak.get().max(live)));
}

// SAFETY: every call is passed unchanged to the system allocator; counting accesses only constant
// thread-locals without destructors, which neither allocate nor unwind.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller upholds the contract of `alloc`, which is the same for the system
        // allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        hold(-(layout.size() as i64));
        // SAFETY: `block` was allocated by the system allocator, as all blocks of this allocator.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        hold(-(layout.size() as i64));
        // SAFETY: `block` was allocated by the system allocator, as all blocks of this allocator.
        unsafe { System.dealloc(block, layout) }
    }
}

/// Number of allocations of this thread so far.
pub fn calls() -> u64 {
    CALLS.get()
}

/// Bytes allocated by this thread so far, freed or not.
pub fn bytes() -> u64 {
    BYTES.get()
}

/// Number of allocations of this thread during `work`.
pub fn allocations(work: impl FnOnce()) -> u64 {
    let before = calls();
    work();
    calls() - before
}

/// Result of `work`, and the maximum number of bytes that this thread held for it at a time.
pub fn peak<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let before = LIVE.get();
    PEAK.set(before);
    let done = work();
    (done, u64::try_from(PEAK.get() - before).unwrap_or_default())
}
