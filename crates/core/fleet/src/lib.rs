#![doc = include_str!("../README.md")]
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
pub use fleet::outputs::{ForEachOutput, Output, each_output};
pub use ingest::frame::{FrameIntake, TickIntake};
pub use ingest::refused::{RefusalLog, RefusedSamples};
pub use joulebus_energy::ErrorCounts;
pub use ledger::battery::{SavedBattery, SavedLessons, SavedPause, StatedBattery};
pub use ledger::energy::Ledger;
pub use state::snapshot::{FleetState, StateError};
pub use tick::batch::Batch;
pub use tick::outputs::{OutputRows, Outputs, SecondaryOutputs};
pub use tick::schedule::{Next, Schedule};
pub use tick::shard::{Shard, Stage};
