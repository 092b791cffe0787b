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

pub use checkpoint::LearnedCapacity;
pub use error::OpenError;
pub use joulebus_fleet::{RefusalLog, RefusedSamples};
pub use ledger_files::{LedgerFileError, learned_capacities};
pub use report::{Parts, Report};
pub use standby::PermitOver;
pub use tick_pool::{TickPool, TickPoolError};
pub use worker::{RunError, Worker};
