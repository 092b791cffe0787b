//! Missions of simulated robots under several charging policies: what energy forecasts are worth.
//!
//! Robots of `joulebus-plant` with true batteries do tasks; the fleet's core reads their power
//! monitors, and policies decide by what planners read: never by the true state. All of a mission
//! but the [`Policy`] is the same for all of them; the same seed gives the same bits.
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

pub use error::MissionError;
pub use picture::{PictureError, picture};
pub use policy::Policy;
pub use run::{Outcome, mission};
pub use scenario::{SPEED_MPS, Scenario};
pub use summary::{Comparison, PolicySummary, Runs, Summary};
pub use tuned::{CHOSEN, tried};
