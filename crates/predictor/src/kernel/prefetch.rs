//! Memory asked for before it is needed.

/// Bytes that come at a time.
const LINE: usize = 64;

/// Has these values brought into the core's second cache, since they will soon be needed. It is a hint:
/// nothing is waited for, and what it does can be seen in time only.
#[inline(always)]
pub fn prefetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        let first = values.as_ptr().cast::<i8>();
        let mut offset = 0;
        while offset < size_of_val(values) {
            // SAFETY: the instruction reads nothing that a program could see, and faults nowhere;
            // every x86-64 CPU has it.
            unsafe { _mm_prefetch::<_MM_HINT_T1>(first.wrapping_add(offset)) };
            offset += LINE;
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, LINE);
}
