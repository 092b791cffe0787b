#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod answer;
mod candidates;
mod error;
mod estimate;
mod fleet;
mod follower;
mod limits;
mod path;
mod payload;
mod platform;
mod question;
#[doc(hidden)] // For the programs, which print and send answers.
pub mod report;
mod robot;
mod route;
mod shape;
mod trip;

pub use answer::{Answer, Caveats, Doubts, Left, Limits, Range, Unknown, Verdict};
pub use candidates::Candidates;
pub use error::{AskError, Differs, PathError, QuestionError, Refused};
pub use estimate::first_energy;
pub use fleet::PlanFleet;
#[doc(inline)]
pub use joulebus_energy::{Outside, Quantity};
pub use limits::MAX_STEPS;
pub use path::{Path, Point};
pub use platform::{Frames, Platform, RobotRows};
pub use question::{Plan, Question, Reply, Row};
pub use robot::Robot;
pub use shape::Simplified;
pub use trip::{Ranked, Trip, rank, rank_each};

/// Acknowledgements of alarms, as they travel among questions: `planner` sends them, the worker's
/// thread (`plan-server`) takes them.
#[doc(hidden)]
pub mod acknowledgement {
    pub use crate::payload::{decode_acknowledgement as decode, encode_acknowledgement as encode};
}

/// What persons state of robots' batteries, as it travels among questions.
#[doc(hidden)]
pub mod statement {
    pub use crate::payload::{decode_statement as decode, encode_statement as encode};
}

/// Answering in short steps, for programs that answer others meanwhile or can be interrupted: the
/// worker's thread, `joulebus serve`, Python and C. [`Question::answer`] does all at once.
#[doc(hidden)]
pub mod answering {
    pub use crate::question::Work;
}

/// The commands of a path, as a robot that follows it gets them: for programs that drive, such as
/// simulated missions.
pub mod follow {
    pub use crate::follower::{Followed, Follower, Pose};
}
