#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod checkpoint;
mod checkpointer;
mod error;
mod journal;
mod keyframes;
mod ledger_files;
mod outbox;
mod pause;
mod report;
mod save_schedule;
mod shedding;
mod source_ports;
mod standby;
mod state_directory;
mod tick_pool;
mod worker;

pub use error::OpenError;
pub use ledger_files::LedgerFileError;
pub use report::{Parts, Report};
pub use standby::PermitOver;
pub use tick_pool::{TickPool, TickPoolError};
pub use worker::{RunError, Worker};

// For the programs of joulebus: other users have no use for them.
#[doc(hidden)]
pub use checkpoint::LearnedCapacity;
#[doc(hidden)]
pub use joulebus_fleet::{RefusalLog, RefusedSamples};
#[doc(hidden)]
pub use ledger_files::learned_capacities;
