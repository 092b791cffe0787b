//! The tick, pure: samples in, forecasts, diagnostics and budgets out.
//!
//! No clock, file, thread or shared memory: time is an argument, so that a live run, a replay and a
//! simulation execute the same code.
//!
//! A [`Fleet`] [takes](Fleet::take) frames of samples, then [ticks](Fleet::tick), and then writes
//! [forecasts](Fleet::forecast), [diagnostics](Fleet::diagnostic) and [budgets](Fleet::budget),
//! robot by robot, into the caller's memory: the worker passes loaned shared memory. [`Schedule`]
//! determines when a tick is due. [`OnlineForecasts`] are the forecasts and intervals alone.
//!
//! After [`Fleet::new`] no fleet allocates.
#![forbid(unsafe_code)]

mod alarms;
mod estimate;
mod fleet;
mod ingest;
mod layout;
mod ledger;
mod state;
mod tick;

pub use estimate::online::Learned;
pub use estimate::scores::Scores;
pub use fleet::Fleet;
pub use fleet::online_forecasts::{IntervalForecast, OnlineForecasts, OnlineSettings};
pub use ingest::frame::{FrameIntake, TickIntake};
pub use joulebus_energy::ErrorCounts;
pub use ledger::battery::SavedBattery;
pub use ledger::energy::Ledger;
pub use state::snapshot::{FleetState, StateError};
pub use tick::batch::Batch;
pub use tick::schedule::{Next, Schedule};
pub use tick::shard::{Accounts, Outputs, Shard, Stage};
