//! Questions as values: the same in the planner's process, in the worker, and in a recording.

use joulebus_wire::MAX_QUERY_CANDIDATES;

use crate::answer::{Answer, Verdict};
use crate::candidates::Candidates;
use crate::error::{AskError, QuestionError};
use crate::fleet::PlanFleet;
use crate::path::{Path, Point};
use crate::platform::RobotRows;
use crate::robot::{Robot, stale};
use crate::route::{Route, Ways};

/// Maximum number of moments of a question.
const MAX_MOMENTS: usize = MAX_QUERY_CANDIDATES;

/// A question about one robot or several.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// The plan of the robots.
    pub plan: Plan,
    /// Coverage of the intervals, 0.5 to 0.999.
    pub coverage: f32,
    /// True if the power of every step is wanted: of candidates, or of one robot that follows a
    /// path.
    pub power: bool,
    /// Number of evenly spaced moments of one robot's path or rest up to which its part is answered
    /// too: how energy and charge go along the trip. At most 256.
    pub moments: usize,
}

/// A plan for robots.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Plan {
    /// One robot: each of several sequences of commands ([`Candidates`]).
    WhatIf {
        /// Id of the robot.
        robot: u32,
        /// Number of candidates.
        candidates: usize,
        /// Time that each command is in force, s.
        period_s: f32,
        /// Linear velocities, m/s.
        v_mps: Vec<f32>,
        /// Angular velocities, rad/s.
        omega_radps: Vec<f32>,
    },
    /// Stand still.
    Idle {
        /// Ids of the robots, which are answered in this order.
        robots: Vec<u32>,
        /// For this time, s.
        duration_s: f32,
    },
    /// Follow a path, and return. Several robots are answered the best first, as by
    /// [`crate::rank`].
    Follow {
        /// Ids of the robots.
        robots: Vec<u32>,
        /// The path.
        path: Path,
        /// The point to return to.
        back_to: Option<Point>,
    },
}

impl Default for Question {
    /// About no robot.
    fn default() -> Self {
        Self {
            plan: Plan::Idle { robots: Vec::new(), duration_s: 0.0 },
            coverage: 0.9,
            power: false,
            moments: 0,
        }
    }
}

impl Plan {
    /// Ids of the robots asked about.
    #[must_use]
    pub fn robots(&self) -> &[u32] {
        match self {
            Self::WhatIf { robot, .. } => std::slice::from_ref(robot),
            Self::Idle { robots, .. } | Self::Follow { robots, .. } => robots,
        }
    }
}

/// The answer to a [`Question`].
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct Reply {
    /// Rows of each candidate, or of each robot.
    pub rows: Vec<Row>,
    /// Answers to the parts of the plan up to each moment, if requested. The last part is the whole.
    pub along: Vec<Row>,
    /// Power of every step, W, candidate by candidate, if requested, with loads. NaN if the robot's
    /// state is unknown.
    pub power_w: Vec<f32>,
}

/// The answer to one candidate, or of one robot.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Row {
    /// Id of the robot.
    pub robot: u32,
    /// The answer.
    pub answer: Answer,
    /// Same as [`crate::Trip::turn_back_s`].
    pub turn_back_s: Option<f32>,
}

impl Row {
    /// An answer that is not about returning.
    #[must_use]
    pub const fn new(robot: u32, answer: Answer) -> Self {
        Self { robot, answer, turn_back_s: None }
    }
}

impl Question {
    /// The answer. `find` gives the robots' rows. Each path has at most `max_steps` steps, the
    /// path back included: [`crate::MAX_STEPS`] unless time is short.
    ///
    /// # Errors
    /// [`QuestionError`].
    pub fn answer(
        self,
        fleet: &PlanFleet,
        find: impl Fn(u32) -> Option<RobotRows>,
        max_steps: usize,
    ) -> Result<Reply, QuestionError> {
        let mut work = Work::begin(self, find, max_steps)?;
        while !work.step(fleet)? {}
        Ok(work.finish())
    }
}

/// Answers a question in short steps, so that it can be interrupted.
///
/// The slow part does not depend on the robots' rows: following a path and the paths back from it,
/// once for each platform. Rows that have become stale meanwhile are therefore
/// [renewed](Work::renew), and only the energies computed again.
#[derive(Debug, Clone, Default)]
pub struct Work {
    question: Question,
    robots: Vec<RobotRows>,
    /// The path, by the platform's place.
    routes: Vec<(u16, Route)>,
    max_steps: usize,
    done: usize,
    reply: Reply,
}

impl Work {
    /// Begins, with the robots as they are now. Arguments and errors as of [`Question::answer`].
    ///
    /// # Errors
    /// [`QuestionError::UnknownRobot`].
    pub fn begin(
        question: Question,
        find: impl Fn(u32) -> Option<RobotRows>,
        max_steps: usize,
    ) -> Result<Self, QuestionError> {
        let ids = question.plan.robots().iter();
        let rows =
            ids.map(|robot| find(*robot).ok_or(QuestionError::UnknownRobot { robot: *robot }));
        Ok(Self {
            robots: rows.collect::<Result<_, _>>()?,
            question,
            routes: Vec::new(),
            max_steps,
            done: 0,
            reply: Reply::default(),
        })
    }

    /// Restarts with the robots' present rows, and keeps the followed paths.
    ///
    /// # Errors
    /// [`QuestionError::UnknownRobot`].
    pub fn renew(self, find: impl Fn(u32) -> Option<RobotRows>) -> Result<Self, QuestionError> {
        let Self { question, routes, max_steps, .. } = self;
        let begun = Self::begin(question, find, max_steps)?;
        Ok(Self { routes, ..begun })
    }

    /// True if the state of a robot is stale at a time, monotonic ns: older than two ticks.
    #[must_use]
    pub fn is_stale(&self, now_ns: u64) -> bool {
        let mut robots = self.robots.iter();
        robots.any(|rows| stale(&rows.header, now_ns).is_some())
    }

    /// Follows a path or a way back, or answers about the next robot. Returns whether all are
    /// answered.
    ///
    /// # Errors
    /// [`QuestionError`].
    pub fn step(&mut self, fleet: &PlanFleet) -> Result<bool, QuestionError> {
        self.advance(fleet)?;
        Ok(self.done >= self.robots.len())
    }

    /// Answers for all remaining robots, or until one more path has been followed. Returns whether
    /// all are answered. Without paths to follow this takes some microseconds a robot.
    ///
    /// # Errors
    /// [`QuestionError`].
    pub fn rest(&mut self, fleet: &PlanFleet) -> Result<bool, QuestionError> {
        while self.advance(fleet)? {}
        Ok(self.done >= self.robots.len())
    }

    /// Answers about the next robot, unless a way has to be followed first. Returns whether there
    /// was one to answer.
    fn advance(&mut self, fleet: &PlanFleet) -> Result<bool, QuestionError> {
        let Some(rows) = self.robots.get(self.done) else {
            return Ok(false);
        };
        let (id, platform) = (rows.state.robot, rows.state.platform);
        let robot = fleet.robot(&rows.frames());
        let robot = robot.ok_or(QuestionError::UnknownRobot { robot: id })?;
        let is_answered = self.one(&robot, platform)?;
        self.done += usize::from(is_answered);
        Ok(is_answered)
    }

    /// The reply, after the last step, as of the time at which the answering began.
    #[must_use]
    pub fn finish(self) -> Reply {
        let mut reply = self.reply;
        if matches!(self.question.plan, Plan::Follow { .. }) {
            reply.rows.sort_by(best_first);
        }
        reply
    }

    /// Same as [`Work::finish`], for a reply that is sent at a time, monotonic ns. If a robot's
    /// state is stale by then, [`Verdict::Yes`] becomes [`Unknown::Stale`](crate::Unknown::Stale),
    /// and there is no time to turn back.
    #[must_use]
    pub fn finish_at(mut self, sent_ns: u64) -> Reply {
        for row in self.reply.rows.iter_mut().chain(&mut self.reply.along) {
            let of = self.robots.iter().find(|rows| rows.state.robot == row.robot);
            let Some(reason) = of.and_then(|rows| stale(&rows.header, sent_ns)) else {
                continue;
            };
            row.turn_back_s = None;
            if row.answer.verdict == Verdict::Yes {
                row.answer.verdict = Verdict::Unknown(reason);
            }
        }
        self.finish()
    }

    /// True if the robot is answered, or a way was followed first.
    fn one(&mut self, robot: &Robot<'_>, platform: u16) -> Result<bool, QuestionError> {
        let Question { plan, coverage, power, moments } = &self.question;
        let moments = if self.robots.len() == 1 { *moments } else { 0 };
        if moments > MAX_MOMENTS {
            return Err(AskError::Moments { found: moments, allowed: MAX_MOMENTS }.into());
        }
        let row = |answer, turn_back_s| Row { robot: robot.id(), answer, turn_back_s };
        match plan {
            Plan::WhatIf { candidates, period_s, v_mps, omega_radps, .. } => {
                let plans = Candidates::new(*candidates, *period_s, v_mps, omega_radps)?;
                let answers = robot.what_if(&plans, *coverage)?;
                self.reply.rows = answers.into_iter().map(|answer| row(answer, None)).collect();
                if *power {
                    self.reply.power_w = powers(robot, &plans)?;
                }
            }
            Plan::Idle { duration_s, .. } => {
                let (answer, along) = robot.idle_along(*duration_s, *coverage, moments)?;
                self.reply.rows.push(row(answer, None));
                self.reply.along = along.into_iter().map(|answer| row(answer, None)).collect();
            }
            Plan::Follow { path, back_to, .. } => {
                let known = self.routes.iter().position(|(of, _)| *of == platform);
                let Some(known) = known else {
                    let route = Route::new(robot, path, *back_to, self.max_steps, moments)?;
                    self.routes.push((platform, route));
                    return Ok(false);
                };
                let route = &mut self.routes[known].1;
                let answer = robot.on(route, *coverage)?;
                let turned = robot.turn_back_s(route, &answer, *coverage, &mut Ways(1))?;
                let Ok(turn_back_s) = turned else {
                    return Ok(false);
                };
                self.reply.rows.push(row(answer, turn_back_s));
                let along = robot.along(&route.legs(robot), *coverage, moments);
                self.reply.along = along.into_iter().map(|answer| row(answer, None)).collect();
                if *power && self.robots.len() == 1 {
                    let followed = route.whole();
                    let columns = (&followed.v_mps, &followed.omega_radps);
                    let plan = Candidates::new(1, followed.period_s, columns.0, columns.1)?;
                    self.reply.power_w = powers(robot, &plan)?;
                    followed.add_loads(&mut self.reply.power_w);
                }
            }
        }
        Ok(true)
    }
}

fn powers(robot: &Robot<'_>, plans: &Candidates<'_>) -> Result<Vec<f32>, QuestionError> {
    let mut power_w = vec![f32::NAN; plans.count() * plans.steps()];
    robot.power_w(plans, &mut power_w)?;
    Ok(power_w)
}

impl Reply {
    /// The rows, the best first: by verdict (yes, tight, no, unknown), then robots without alarms on
    /// their readings, then by the expected energy, then by id.
    #[must_use]
    pub fn ranked(&self) -> Vec<&Row> {
        let mut rows: Vec<&Row> = self.rows.iter().collect();
        rows.sort_by(|one, other| best_first(one, other));
        rows
    }
}

/// Orders by verdict (yes, tight, no, unknown), then robots without alarms on their readings first,
/// then by the expected energy, then by id.
pub(crate) fn best_first(one: &Row, other: &Row) -> std::cmp::Ordering {
    let class = |row: &Row| {
        let verdict = match row.answer.verdict {
            Verdict::Yes => 0,
            Verdict::Tight => 1,
            Verdict::No => 2,
            Verdict::Unknown(_) => 3,
        };
        (verdict, !row.answer.caveats.alarms.is_empty())
    };
    let mean_j = |row: &Row| row.answer.energy.map_or(f32::INFINITY, |energy| energy.mean_j);
    class(one)
        .cmp(&class(other))
        .then(mean_j(one).total_cmp(&mean_j(other)))
        .then(one.robot.cmp(&other.robot))
}
