//! The function to which callgrind restricts its collection.

use std::hint::black_box;

/// Runs the work. `tools/instructions.py` collects only inside of this function, by its name.
#[inline(never)]
pub(crate) fn collected(work: &mut dyn FnMut()) {
    work();
    // Prevents a tail call, which would leave the function before the work begins.
    black_box(());
}
