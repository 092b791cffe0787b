//! SDK of a planner that asks before it moves: what a plan costs, whether the robot makes it, which
//! robot does it for the least, when it must turn back. `joulebus-plan` has questions and answers.
//!
//! ```no_run
//! use std::time::Duration;
//!
//! use anyhow::Context;
//! use joulebus_plan::{Path, Point, Verdict};
//! use joulebus_planner::Planner;
//!
//! fn main() -> anyhow::Result<()> {
//!     let mut planner = Planner::connect("configs/fleet.toml")?;
//!     let view = planner.wait(Duration::from_secs(1))?;
//!     let robot = view.robot(7).context("robot 7 is not in the fleet")?;
//!     let there = Path::new(&[Point::new(0.0, 0.0), Point::new(2.0, 1.0)], 0.2);
//!     let trip = robot.can_finish(&there, Some(Point::new(0.0, 0.0)), 0.9)?;
//!     if trip.answer.verdict == Verdict::Yes {
//!         println!("go: it can drive there and return");
//!     } else if let Some(turn_back_s) = trip.turn_back_s {
//!         println!("turn back within {turn_back_s} s");
//!     }
//!     Ok(())
//! }
//! ```
//!
//! **Three types to know.** A [`Planner`] computes in this process, from what the worker writes
//! into shared memory. It needs no request and no queue, and puts no load on the worker beyond
//! writing. A [`View`] is the fleet at one tick, whose robots answer questions. A [`PlanClient`]
//! asks a thread of the worker instead, for a process that cannot compute. A question is the same
//! value for both.
//!
//! **Units** are W, J, s, ns, m and rad.
//!
//! **Errors** state the remedy: [`ConnectError`] at the start, [`ViewError`] and [`ClientError`]
//! later. After the latter two, the next call may succeed.
//!
//! **In the book**: [ask before you move][1], [questions that the worker answers][2],
//! [verdicts][3], [energy over a horizon][4].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/ask.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/ask-the-worker.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/verdicts.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/energy.md
#![forbid(unsafe_code)]

mod client;
mod planner;

pub use client::{Answered, ClientError, PlanClient, QueryError};
pub use joulebus_config::Config;
pub use joulebus_connect::{ConnectError, error};
pub use joulebus_consumer::{ReadError, WorkerState};
pub use joulebus_models::ModelsError;
pub use planner::{Planner, View, ViewError};
