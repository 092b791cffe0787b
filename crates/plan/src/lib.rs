//! SDK of a planner that asks before it moves: what a plan costs, whether the robot makes it, which
//! robot does it for the least, when it must turn back.
//!
//! ```no_run
//! use std::time::Duration;
//!
//! use joulebus_plan::{Path, Planner, Point, Verdict};
//!
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let mut planner = Planner::connect("configs/fleet.toml")?;
//!     let view = planner.wait(Duration::from_secs(1))?;
//!     let robot = view.robot(7).ok_or("robot 7 is not in the fleet")?;
//!     let there = Path::new(&[Point::new(0.0, 0.0), Point::new(2.0, 1.0)], 0.2);
//!     let trip = robot.can_finish(&there, Some(Point::new(0.0, 0.0)), 0.9)?;
//!     if trip.answer.verdict == Verdict::Yes {
//!         println!("go, and turn back within {:?} s", trip.turn_back_s);
//!     }
//!     Ok(())
//! }
//! ```
//!
//! **Where it is computed.** In the planner's process, from what the worker writes into shared memory
//! for each robot and tick ([`joulebus_consumer::wire::PlanState`]), with the models that the fleet's
//! config names: no request, no queue, no load on the worker beyond writing. A [`Robot`] is a checked
//! copy; it is `Send` and `Sync`, so that a planner can ask in as many threads as it likes. The same
//! frame and the same question give the same bits in every thread and process.
//!
//! **Fail closed.** A verdict is [`Verdict::Yes`] only if the energy's upper end at the asked coverage
//! fits into the lower bound of what the battery can spare, at the end of every leg, and nothing weakens that
//! statement. Commands outside the training data and plans longer than the longest calibrated horizon widen
//! the interval to what the platform can draw at most and at least; these, a robot without readings and one
//! outside the training data ([`Caveats`]) allow [`Verdict::Tight`] at best. What is stale, invalid or unknown gives [`Verdict::Unknown`] with
//! its reason.
//!
//! **Units**: W, J, s, m, rad.
//!
//! A process that cannot compute asks a thread of the worker instead: [`PlanClient`]. A [`Question`] is the
//! same value for both.
//!
//! The modules below [`Planner`] are pure: a [`Fleet`] with models and settings, and a [`Robot`] made
//! from rows of any origin.
#![forbid(unsafe_code)]

mod answer;
mod candidates;
mod client;
mod error;
mod estimate;
mod fleet;
mod follower;
mod limits;
mod payload;
mod planner;
mod platform;
mod question;
mod report;
mod robot;
mod route;
mod trip;

pub use answer::{Answer, Caveats, Left, Range, Unknown, Verdict};
pub use candidates::Candidates;
pub use client::{Answered, ClientError, OpenClientError, PlanClient, QueryError};
pub use error::{AskError, Differs, PathError, QuestionError, Refused};
pub use fleet::Fleet;
pub use follower::{Followed, Follower, Path, Point, Pose};
pub use joulebus_config::{Config, ConnectError};
pub use joulebus_consumer::{OpenError, ReadError, WorkerState};
pub use joulebus_models::ModelsError;
pub use limits::MAX_STEPS;
pub use planner::{OpenPlannerError, Planner, View, ViewError};
pub use platform::{Frames, Platform, RobotRows};
pub use question::{Plan, Question, Reply, Row, Work};
pub use report::{AnswerReport, AnswersReport};
pub use robot::Robot;
pub use trip::{Ranked, Trip, rank, rank_each};
