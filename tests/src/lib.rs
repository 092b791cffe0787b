//! Support for the system tests: a separate [`Arena`] for each test, processes ([`Child`]), and
//! test-side [`Source`]s and [`Planner`]s.
//!
//! The tests never access shared memory themselves, because members of a fleet are killed, paused
//! and starved: a small program, `joulebus-probe`, does so and reports in JSON lines. Nothing here
//! sleeps to synchronise: everything waits for a condition, with the timeout [`PATIENCE`].
#![allow(missing_docs)] // Used by tests alone.
#![forbid(unsafe_code)]

mod arena;
mod figure;
mod planner;
mod protocol;
mod script;
mod source;

pub use arena::{Arena, Setup, alone, program, without_loss};
pub use figure::{Dice, Spread, figure};
pub use joulebus_testkit::{Child, Ended, MemoryGroup, PATIENCE, as_in_docker, eventually};
pub use planner::{Answers, Planner};
pub use protocol::{
    Answer, AskerLine, Forge, FrameLine, FrameRead, ReaderLine, SourceLine, accounted, answer,
    names,
};
pub use script::{is_whole, sample, script, steady};
pub use source::Source;
