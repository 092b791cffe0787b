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
mod spoilt;

pub use arena::{Arena, Setup, alone, program, without_loss};
pub use figure::{Dice, Spread, figure};
pub use joulebus_testkit::{Child, Ended, MemoryGroup, PATIENCE, as_in_docker, eventually};
pub use planner::{Answers, Planner};
pub use protocol::{
    Answer, AskerLine, Forge, FrameLine, FrameRead, ReaderLine, SourceLine, accounted, answer,
    drawn_exact, names, tick_ns,
};
pub use script::{is_whole, sample, script, steady, steady_uw};
pub use source::Source;
pub use spoilt::spoilt;
