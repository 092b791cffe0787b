//! A host with a fleet: its processes in the order of simulated time, and their faults.

mod faults;
mod lives;
mod outcome;
mod recovery;
mod run;
mod slot;
mod state;
mod steps;

pub use outcome::Outcome;
pub use run::run;
