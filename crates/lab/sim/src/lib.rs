//! Recordings of simulated robots: the paper's six trials, its seven robots, and training data.
//! The robots themselves are those of [`joulebus_plant`].
#![forbid(unsafe_code)]

pub mod barrier;
pub mod protocol;
mod recorder;
pub mod scenario;
pub mod training_data;
