//! The tick, pure: samples in, forecasts, diagnostics and budgets out.
//!
//! No clock, file, thread or shared memory: time comes in as an argument, so that a live run, a
//! replay and a simulation are the same code.
//!
//! A [`Fleet`] [takes](Fleet::take) frames of samples as they come, then [ticks](Fleet::tick), and
//! then writes out [forecasts](Fleet::forecast), [diagnostics](Fleet::diagnostic) and
//! [budgets](Fleet::budget), robot by robot, wherever the caller wants them: the worker has them
//! written straight into shared memory. [`Schedule`] says when a tick is due.
//!
//! After [`Fleet::new`] nothing here allocates.
#![forbid(unsafe_code)]

mod account;
mod adaptation;
mod admission;
mod batch;
mod columns;
mod departed;
mod detector;
mod fleet;
mod index;
mod intake;
mod interval;
mod lanes;
mod ledger;
mod mixture;
mod pass;
mod platform_context;
mod refused;
mod remaining;
mod report;
mod robot;
mod schedule;
mod scores;
mod shard;
mod slots;
mod sources;
mod state;
mod step;
mod step_block;
mod window;

pub use batch::Batch;
pub use fleet::{Fleet, FrameIntake, TickIntake};
pub use ledger::Ledger;
pub use mixture::Learned;
pub use schedule::{Next, Schedule};
pub use scores::Scores;
pub use shard::{Outputs, Shard, Stage};
pub use state::{FleetState, StateError};
pub use window::missing_steps;
