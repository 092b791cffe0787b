//! Whole fleets in one process, on a simulated host, from one seed.
//!
//! Sources, worker with checkpointer, planners, recorder, boards and a bridge's threads are the
//! shells' own code, compiled against a simulated bus, clock, disk and threads
//! (`tests/simulator/host`, `bus`, `files`). Packages like `tests/simulator/predictor-worker` have
//! the sources of `crates/`. They run as state machines. Between any two of their operations any
//! fault may happen ([`scenario::Fault`]). After each step the invariants are checked
//! ([`world::run`]).
#![allow(missing_docs)] // Used by tests alone.
#![deny(unsafe_code)]

mod allocator;
pub mod campaign;
mod check;
mod grown;
mod hostile;
mod hosts;
mod ledger;
pub mod panics;
mod process;
pub mod scenario;
pub mod shrink;
pub mod world;

pub use check::Failure;
pub use grown::Grown;
