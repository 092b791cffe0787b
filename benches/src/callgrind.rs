//! What callgrind is told to collect.

use std::hint::black_box;

/// Does the work. `tools/instructions.py` collects inside of this function only, by its name.
#[inline(never)]
pub(crate) fn collected(work: &mut dyn FnMut()) {
    work();
    // A tail call would leave the function before the work begins.
    black_box(());
}
