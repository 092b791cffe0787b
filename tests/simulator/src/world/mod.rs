//! A host on which a fleet runs: what its processes do in the order of simulated time, and what happens to them.

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
