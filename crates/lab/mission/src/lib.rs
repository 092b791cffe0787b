//! Missions of simulated robots under several charging policies: the value of energy forecasts.
//!
//! Robots of `joulebus-plant` with true batteries do tasks. The fleet's core reads their power
//! monitors. Policies decide by the values that planners read, never by the true state. Only the
//! [`Policy`] of a mission differs between policies, and the same seed gives the same bits.
#![forbid(unsafe_code)]

mod broker;
mod error;
mod machine;
mod picture;
mod policy;
mod run;
mod scenario;
mod summary;
mod tuned;
#[cfg(test)]
mod turning_back;

pub use error::MissionError;
pub use picture::{PictureError, picture};
pub use policy::Policy;
pub use run::{Outcome, mission};
pub use scenario::{SPEED_MPS, Scenario};
pub use summary::{Comparison, PolicySummary, Runs, Summary};
pub use tuned::{CHOSEN, tried};
