//! The operating system: clocks, memory, scheduling, files.

pub(crate) mod apart;
pub(crate) mod background;
pub mod clock;
pub(crate) mod files;
pub(crate) mod fork;
pub(crate) mod memory;
pub(crate) mod process;
mod process_id;
pub(crate) mod scheduling;
pub(crate) mod watchers;

pub use process_id::process_id;
