//! Missions of simulated robots under several charging policies: the value of energy forecasts.
//!
//! Robots of `joulebus-plant` with true batteries do tasks. The fleet's core reads their power
//! monitors. Policies decide by the values that planners read, never by the true state.
//!
//! ```
//! use joulebus_mission::{Policy, Scenario, mission};
//!
//! let scenario = Scenario { robots: 3, chargers: 1, duration_s: 60.0, ..Scenario::default() };
//! let outcome = mission(&scenario, Policy::Threshold { begin: 0.55, go: 0.3 }, 7)?;
//! assert_eq!((outcome.seed, outcome.stranded, outcome.shared_chargers), (7, 0, 0));
//! // The same seed gives the same bits.
//! let again = mission(&scenario, Policy::Threshold { begin: 0.55, go: 0.3 }, 7)?;
//! assert_eq!((outcome.tasks, outcome.at_work), (again.tasks, again.at_work));
//! # Ok::<(), joulebus_mission::MissionError>(())
//! ```
//!
//! **Three types to know.** A [`Scenario`] has the conditions that are the same for all policies. A
//! [`Policy`] is how robots decide to work and to charge, and the only difference between compared
//! missions. An [`Outcome`] counts tasks, charges and stranded robots. A [`Summary`] compares the
//! outcomes of many seeds. [`CHOSEN`] has the policies with their tuned settings.
//!
//! The program `joulebus-lab` has this crate as `joulebus mission`.
//!
//! **Units** are s, J, W and m. States of charge and shares are 0 to 1.
//!
//! **Errors** ([`MissionError`]) are those of the config, the models, the plans and the network. A
//! mission whose samples were refused is an error too.
//!
//! **In the book**: [missions, what forecasts are worth][1], [how a mission is judged][2], [the
//! simulated robots][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/measured/mission.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/plans-energy.md#a-mission-is-judged-by-stranded-robots-and-finished-tasks
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/plant.md
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
