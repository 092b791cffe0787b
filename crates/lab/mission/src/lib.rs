#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod broker;
mod error;
mod machine;
mod policy;
mod run;
mod scenario;
mod summary;
mod tuned;
#[cfg(test)]
mod turning_back;

pub use error::MissionError;
pub use policy::Policy;
pub use run::{Outcome, mission};
pub use scenario::{SPEED_MPS, Scenario};
pub use summary::{Comparison, PolicySummary, Runs, Summary};
pub use tuned::{CHOSEN, tried};
