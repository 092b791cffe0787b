//! The allocator of programs that simulate: it counts what each simulated process has allocated.
#![allow(unsafe_code, reason = "a global allocator requires unsafe code")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr;

use simulated_host::memory::{Account, allocated, freed};

/// Minimum bytes before each block, of which the first is the account.
const LEAST_BEFORE: usize = 16;

struct Counting;

/// The block with what lies before it, and the size of that.
fn extended(layout: Layout) -> Option<(Layout, usize)> {
    let before = layout.align().max(LEAST_BEFORE);
    let size = layout.size().checked_add(before)?;
    Some((Layout::from_size_align(size, before).ok()?, before))
}

// SAFETY: a block of `extended(layout)` has room for one of `layout` behind `before` bytes, a
// multiple of its alignment. Counting accesses only constant thread-locals without destructors,
// which neither allocate nor unwind.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let Some((whole, before)) = extended(layout) else {
            return ptr::null_mut();
        };
        // SAFETY: `whole` is not empty.
        let block = unsafe { System.alloc(whole) };
        // SAFETY: the block is that of `extended(layout)`.
        unsafe { entered(block, layout.size(), before) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        let Some((whole, before)) = extended(layout) else {
            return ptr::null_mut();
        };
        // SAFETY: as in `alloc`.
        let block = unsafe { System.alloc_zeroed(whole) };
        // SAFETY: as in `alloc`.
        unsafe { entered(block, layout.size(), before) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let Some((whole, before)) = extended(layout) else {
            return ptr::null_mut();
        };
        let Some(larger) = size.checked_add(before) else {
            return ptr::null_mut();
        };
        // SAFETY: `block` is of this allocator and `layout`: the system's lies `before` bytes
        // before it, and begins with the account, which was written when it was allocated.
        let (start, account) = unsafe {
            let start = block.sub(before);
            (start, Account::of_byte(start.read()))
        };
        // SAFETY: the system allocated `start` with `whole`; the caller upholds the rest.
        let moved = unsafe { System.realloc(start, whole, larger) };
        if moved.is_null() {
            return moved;
        }
        freed(account, layout.size());
        // SAFETY: the block is that of `extended` of the new size.
        unsafe { entered(moved, size, before) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        let Some((whole, before)) = extended(layout) else {
            return;
        };
        // SAFETY: as in `realloc`.
        unsafe {
            let start = block.sub(before);
            freed(Account::of_byte(start.read()), layout.size());
            System.dealloc(start, whole);
        }
    }
}

/// Enters a block of `size` bytes, `before` bytes after `start`, into the process's account.
///
/// # Safety
/// `start` is null, or a block of more than `before` bytes.
unsafe fn entered(start: *mut u8, size: usize, before: usize) -> *mut u8 {
    if start.is_null() {
        return start;
    }
    let account = allocated(size);
    // SAFETY: by the contract of this function, and `before` is not 0.
    unsafe {
        start.write(account.byte());
        start.add(before)
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
