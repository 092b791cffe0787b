//! What the system tests stand on: an [`Arena`] of its own for each test, real [`Child`] processes,
//! and test-side [`Source`]s and [`Planner`]s.
//!
//! One process can be in one domain only, so the tests themselves never touch shared memory: a
//! small program, `joulebus-probe`, does it for them and speaks JSON lines. Nothing here sleeps in
//! order to synchronise: everything waits for a condition, with [`PATIENCE`].
#![forbid(unsafe_code)]

mod arena;
mod figure;
mod planner;
mod protocol;
mod script;
mod source;

pub use arena::{Arena, Setup, alone, program, without_loss};
pub use figure::{Dice, Spread, figure};
pub use joulebus_test_processes::{Child, Ended, PATIENCE, eventually};
pub use planner::{Answers, Planner};
pub use protocol::{
    BudgetFrame, BudgetLine, DiagnosticFrame, DiagnosticLine, ForecastFrame, ForecastLine, Forge,
    FrameLine, ReaderLine, RefusalLine, SampleLine, SourceLine,
};
pub use script::{is_whole, sample, script, steady, steady_uw};
pub use source::Source;
