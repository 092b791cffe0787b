//! Software prefetch.

/// Bytes of a cache line.
const LINE: usize = 64;

/// Prefetches these values into the core's L2. It is a hint: it does not block, and has no effect
/// except on timing.
#[inline(always)]
pub fn prefetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        let first = values.as_ptr().cast::<i8>();
        let mut offset = 0;
        while offset < size_of_val(values) {
            // SAFETY: the instruction reads nothing that a program could see, and faults nowhere.
            // Every x86-64 CPU has it.
            unsafe { _mm_prefetch::<_MM_HINT_T1>(first.wrapping_add(offset)) };
            offset += LINE;
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, LINE);
}
