//! The predictor-worker: samples from shared memory, through the pure tick, forecasts back into
//! shared memory.
//!
//! The program `joulebus` has this crate as `joulebus run`.
//!
//! ```no_run
//! use std::sync::atomic::AtomicBool;
//!
//! use joulebus_config::Config;
//! use joulebus_predictor_worker::Worker;
//!
//! let mut worker = Worker::open(&Config::load("configs/fleet.toml")?)?;
//! // Until a signal handler sets it.
//! let stop = AtomicBool::new(false);
//! worker.run(&stop)?;
//! println!("{} ticks", worker.finish().ticks);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** A [`Worker`] is one fleet's: [`Worker::open`] does everything that can
//! fail (models, memory, the fleet's worker lock), and [`Worker::run`] then ticks until it is
//! stopped. A [`Report`] states what it did. A [`TickPool`] distributes the tick over threads.
//!
//! **The tick's output** is written directly into loaned shared memory. After warm-up the loop
//! logs nothing and blocks on nothing but samples and its schedule. Each thread locks only its own
//! scratch memory, which no other thread uses meanwhile. The loop allocates nothing of its own:
//! iceoryx2 0.10 allocates once for each of the up to six frames that a tick sends.
//!
//! **Beside the tick.** Logging and the ledger's checkpoints are left to the checkpointer, a thread
//! that reads the worker's frames like any planner.
//!
//! **Units** are those of `joulebus-wire`: SI, and ns for times.
//!
//! **Errors** state the remedy. [`OpenError`] is for the start. [`RunError`] ends a worker that
//! runs.
//!
//! **In the book**: [run a fleet as a service][1], [operate a fleet][2], [the tick][3], [parallel
//! ticks][4], [add a standby worker][5].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/service.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/tutorial/operate.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/measured/tick.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/the-tick.md#parallel-ticks-use-rayons-pool
//! [5]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/standby.md
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
mod source_ports;
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
