//! Energy of plans: the cost of a plan, whether the robot completes it, which robot does it at the
//! least cost, and when it must turn back.
//!
//! Pure: a [`Fleet`] with models and settings, and a [`Robot`] made from rows of any origin.
//! `joulebus-planner` reads the rows of a running fleet.
//!
//! ```
//! # use joulebus_energy::{EnergyModel, EnergySample, EnergyState};
//! use joulebus_plan::{Fleet, Frames, Platform, Unknown, Verdict};
//! # use joulebus_wire::{PlanState, PlanStateHeader, Quality, plan_state_flag};
//! # let text = "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:rover\"\nrobots = [7]\n";
//! # let config = joulebus_config::Config::parse(text, std::path::Path::new("."))?;
//! # let settings = config.settings().platforms[0].clone();
//! # let model = EnergyModel::untrained(3.6);
//! # let mut energy = EnergyState::new(0);
//! # let sample = EnergySample { power_w: 3.6, elapsed_s: 0.1, v_mps: 0.0, omega_radps: 0.0 };
//! # (0..200).for_each(|_| energy.observe(&model, &sample));
//! # let (quality, quality_detail) = Quality::Fresh.encode();
//! # let header = PlanStateHeader { period_ns: 100_000_000, sent_ns: 1, ..Default::default() };
//! # let state = PlanState {
//! #     robot: 7, quality, quality_detail, v_mps: 0.0, omega_radps: 0.0,
//! #     flags: plan_state_flag::SAMPLE | plan_state_flag::LAGS | plan_state_flag::COMMAND,
//! #     energy_j: energy.metered.energy_j, command_j: energy.metered.command_j,
//! #     time_s: energy.metered.time_s, error_lower: energy.bounds.lower,
//! #     error_upper: energy.bounds.upper, ..Default::default()
//! # };
//!
//! // `header` and `state` are rows of robot 7, which has drawn 3.6 W for 20 s.
//! let fleet = Fleet::of(vec![Platform::new(settings, model, 0)], 0);
//! let robot = fleet.robot(&Frames { header: &header, state: &state, budget: None, now_ns: 2 });
//! let answer = robot.ok_or("robot 7 is not in the fleet")?.idle(10.0, 0.9)?;
//! let energy = answer.energy.ok_or("its energy is unknown")?;
//! assert!((35.9..36.1).contains(&energy.mean_j));
//! // Nobody knows what its battery has, so this is no yes.
//! assert_eq!(answer.verdict, Verdict::Unknown(Unknown::NoBattery));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** A [`Plan`] is what a robot would do. A [`Robot`] answers questions
//! about plans. An [`Answer`] has the energy, the verdict and what weakens it.
//!
//! **Computed in the planner's process**, from the rows that the worker writes into shared memory
//! for each robot and tick ([`joulebus_wire::PlanState`]), with the models that the fleet's config
//! names. There is no request, no queue, and no load on the worker beyond writing. A [`Robot`] is a
//! checked copy. It is `Send` and `Sync`, so that a planner can ask in any number of threads. The
//! same frame and the same question give the same bits in every thread and process.
//!
//! **Fail closed.** A verdict is [`Verdict::Yes`] only if the energy's upper bound at the requested
//! coverage fits into the lower bound of the spare energy, at the end of every leg, and nothing
//! weakens that statement. Commands outside the training data widen the interval to the platform's
//! minimum and maximum power. The errors of a plan longer than the longest calibrated horizon are
//! extrapolated. A robot
//! without readings and one outside the training data ([`Caveats`]) allow [`Verdict::Tight`] at
//! best. Stale, invalid or unknown values give [`Verdict::Unknown`] with the reason.
//!
//! **Units**: W, J, s, m, rad.
//!
//! **Errors** name the value that is not allowed, and the allowed ones: [`AskError`] for a question
//! to a robot, [`PathError`] for a path, [`QuestionError`] for a [`Question`]. [`Differs`] states
//! that a worker runs with other settings or models.
//!
//! A process that cannot compute asks a thread of the worker instead. A [`Question`] is the same
//! value for both.
//!
//! **In the book**: [ask before you move][1], [verdicts][2].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/ask.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/verdicts.md
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
pub mod report;
mod robot;
mod route;
mod shape;
mod trip;

pub use answer::{Answer, Caveats, Doubts, Left, Range, Unknown, Verdict};
pub use candidates::Candidates;
pub use error::{AskError, Differs, PathError, QuestionError, Refused};
pub use fleet::Fleet;
pub use limits::MAX_STEPS;
pub use path::{Path, Point};
pub use platform::{Frames, Platform, RobotRows};
pub use question::{Plan, Question, Reply, Row};
pub use robot::Robot;
pub use trip::{Ranked, Trip, rank, rank_each};

/// Acknowledgements of alarms, as they travel among questions: `planner` sends them, the worker's
/// thread (`plan-server`) takes them.
pub mod acknowledgement {
    pub use crate::payload::{decode_acknowledgement as decode, encode_acknowledgement as encode};
}

/// Answering in short steps, for programs that answer others meanwhile or can be interrupted: the
/// worker's thread, `joulebus serve`, Python and C. [`Question::answer`] does all at once.
pub mod answering {
    pub use crate::question::Work;
}

/// The commands of a path, as a robot that follows it gets them: for programs that drive, such as
/// simulated missions.
pub mod follow {
    pub use crate::follower::{Followed, Follower, Pose};
}
