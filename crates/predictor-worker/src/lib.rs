//! The predictor-worker: samples from shared memory, through the pure tick, forecasts back into
//! shared memory.
//!
//! [`Worker::open`] does everything that can fail (models, memory, the fleet's worker lock);
//! [`Worker::run`] then ticks until it is stopped. The tick's output is written directly into
//! loaned shared memory. The network runs in the tick that [`TickPool`] distributes over threads
//! (`joulebus-fleet`, `src/tick/infer.rs`). After warm-up the loop allocates nothing of its own
//! (iceoryx2 0.10 allocates once for each of the four or five frames that a tick sends), takes no
//! lock, logs nothing and blocks on nothing but samples and its schedule. Logging and the ledger's
//! checkpoints are left to the checkpointer, a thread that reads the worker's frames like any
//! planner.
#![forbid(unsafe_code)]

mod checkpoint;
mod checkpointer;
mod journal;
mod keyframes;
mod ledger_files;
mod outbox;
mod report;
mod save_schedule;
mod shedding;
mod standby;
mod state_directory;
mod tick_pool;
mod worker;

pub use checkpointer::CheckpointerError;
pub use ledger_files::LedgerFileError;
pub use report::{Parts, Report};
pub use standby::PermitOver;
pub use tick_pool::{TickPool, TickPoolError};
pub use worker::{OpenError, RunError, Worker};
