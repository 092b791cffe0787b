//! The operating system: clocks, memory, scheduling, files.

pub(crate) mod background;
pub mod clock;
pub(crate) mod files;
pub(crate) mod memory;
pub(crate) mod process;
pub(crate) mod scheduling;
