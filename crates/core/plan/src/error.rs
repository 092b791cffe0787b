//! Errors of asking.

use joulebus_wire::QueryRefusal;

/// Errors of a question.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AskError {
    /// The numbers of commands do not match.
    #[error(
        "{found} values in {column}: allowed are {allowed}, as many for each of {candidates} \
         candidates in both columns"
    )]
    Shape {
        /// The column.
        column: &'static str,
        /// Its length.
        found: usize,
        /// The length required.
        allowed: usize,
        /// Candidates.
        candidates: usize,
    },
    /// No candidate, or none with a step.
    #[error("{candidates} candidates of {steps} steps: at least one of each is needed")]
    Empty {
        /// Candidates.
        candidates: usize,
        /// Steps of each.
        steps: usize,
    },
    /// Too many steps.
    #[error(
        "{found} steps: allowed are {allowed} a candidate or path. Use a longer period, or a \
            shorter path"
    )]
    Steps {
        /// Steps of a candidate.
        found: usize,
        /// The greatest number.
        allowed: usize,
    },
    /// The period of the commands.
    #[error("a period of {found} s: allowed is more than 0 and at most {allowed} s")]
    Period {
        /// The period, s.
        found: f32,
        /// The longest, s.
        allowed: f32,
    },
    /// A command that is not a number, or that the platform cannot follow.
    #[error(
        "{column} of candidate {candidate}, step {step} is {found:?}: platform {platform} follows \
         −{allowed} to {allowed} (`v_max_mps`, `omega_max_radps` in its config)"
    )]
    Command {
        /// The column.
        column: &'static str,
        /// The candidate, from 0.
        candidate: usize,
        /// The step, from 0.
        step: usize,
        /// The value.
        found: f32,
        /// The platform.
        platform: String,
        /// The limit.
        allowed: f32,
    },
    /// Too many moments.
    #[error("{found} moments along the plan: allowed are {allowed}")]
    Moments {
        /// Number of moments.
        found: usize,
        /// The greatest number.
        allowed: usize,
    },
    /// The coverage.
    #[error("a coverage of {found}: allowed are 0.5 to 0.999")]
    Coverage {
        /// The coverage.
        found: f32,
    },
    /// A duration.
    #[error("a duration of {found} s: allowed is more than 0 and at most {allowed} s")]
    Duration {
        /// The duration, s.
        found: f32,
        /// The longest, s.
        allowed: f32,
    },
    /// The length of a slice for results.
    #[error("memory for {found} results: {allowed} are needed")]
    Results {
        /// Its length.
        found: usize,
        /// The number of results.
        allowed: usize,
    },
    /// The path.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// Errors of answering a [`crate::Question`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum QuestionError {
    /// A robot that is not in the fleet.
    #[error(
        "robot {robot} is not in the fleet: its source must publish samples of it (`joulebus watch --once` \
         lists the robots)"
    )]
    UnknownRobot {
        /// Its id.
        robot: u32,
    },
    /// The question about a robot is wrong.
    #[error(transparent)]
    Ask(#[from] AskError),
}

/// A question that was not answered, and why.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("refused ({}): {text}", reason.name())]
pub struct Refused {
    /// The reason.
    pub reason: QueryRefusal,
    /// The found value, the allowed one, and the remedy.
    pub text: String,
}

impl Refused {
    /// With its text.
    #[must_use]
    pub const fn new(reason: QueryRefusal, text: String) -> Self {
        Self { reason, text }
    }
}

/// Errors of turning a path into commands.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PathError {
    /// Fewer than two points.
    #[error(
        "a path of {found} points: at least two are needed, where the robot is and where it goes"
    )]
    Points {
        /// Number of points.
        found: usize,
    },
    /// A coordinate that is not a number, or too far away.
    #[error("{column} of point {point} is {found:?}: allowed are −{allowed} to {allowed}")]
    Coordinate {
        /// The column.
        column: &'static str,
        /// The point, from 0.
        point: usize,
        /// The value.
        found: f64,
        /// The limit.
        allowed: f64,
    },
    /// A column that has neither no value nor one for each point.
    #[error("{column} has {found} values: allowed are none or {allowed}, one for each point")]
    Column {
        /// The column.
        column: &'static str,
        /// Number of its values.
        found: usize,
        /// Number of points.
        allowed: usize,
    },
    /// A value that is not a number, or out of bounds.
    #[error("{column} of point {point} is {found:?}: allowed are {} to {}", allowed.0, allowed.1)]
    Value {
        /// The column.
        column: &'static str,
        /// The point, from 0.
        point: usize,
        /// The value.
        found: f64,
        /// The least and the greatest.
        allowed: (f64, f64),
    },
    /// A time before that of the point before.
    #[error("point {point} has the time {found} s, the point before {before} s: times never fall")]
    Falls {
        /// The point, from 0.
        point: usize,
        /// Its time, s.
        found: f64,
        /// The time of the point before, s.
        before: f64,
    },
    /// Both times and waits.
    #[error(
        "a path has either time_s or dwell_s: with times, repeat a point with the time at which the \
         robot leaves it"
    )]
    DwellWithTimes,
    /// A tolerance that is not allowed.
    #[error(
        "a tolerance of {found} m: allowed are 0 to {allowed} m, half a cell of the planner's grid"
    )]
    Tolerance {
        /// The tolerance, m.
        found: f32,
        /// The greatest, m.
        allowed: f32,
    },
    /// A speed that is not above 0.
    #[error("a speed of {found} m/s towards point {point}: it must be above 0")]
    Speed {
        /// The point, from 0.
        point: usize,
        /// The value.
        found: f64,
    },
    /// A speed above the platform's.
    #[error(
        "a speed of {found} m/s towards point {point}: platform {platform} drives at most {allowed} m/s \
         (`v_max_mps` in its config). Ask for that or less, or for no speed: then it is the highest \
         that the model knows"
    )]
    TooFast {
        /// The point, from 0.
        point: usize,
        /// The value.
        found: f64,
        /// The platform.
        platform: String,
        /// Its greatest velocity, m/s.
        allowed: f32,
    },
    /// The platform cannot be commanded to move.
    #[error(
        "platform {platform} allows {v_max_mps} m/s and {omega_max_radps} rad/s: a path needs both \
         above 0 (`v_max_mps`, `omega_max_radps` in its config)"
    )]
    Immobile {
        /// The platform.
        platform: String,
        /// Its greatest velocity, m/s.
        v_max_mps: f32,
        /// Its greatest angular velocity, rad/s.
        omega_max_radps: f32,
    },
    /// The path takes more steps than are allowed.
    #[error(
        "point {point} is still {distance_m:.2} m away after {allowed} steps, as many as a path may have: give it a \
         higher speed, or a shorter path"
    )]
    TooLong {
        /// The point, from 0.
        point: usize,
        /// Distance to it, m.
        distance_m: f64,
        /// The greatest number of steps of a path.
        allowed: usize,
    },
    /// The path takes more steps than are allowed, because the robot waits.
    #[error(
        "a wait of {found_s} s at point {point}: a path may take {allowed_s} s in all. Ask about the rest after \
         the wait"
    )]
    Waits {
        /// The point, from 0.
        point: usize,
        /// The wait, s.
        found_s: f64,
        /// The longest path, s.
        allowed_s: f64,
    },
    /// The follower does not get there.
    #[error(
        "point {point} is still {distance_m:.2} m away after {steps} steps: give it a lower speed, or \
         more distance to the one before"
    )]
    NotReached {
        /// The point, from 0.
        point: usize,
        /// Distance to it, m.
        distance_m: f64,
        /// Steps so far.
        steps: usize,
    },
}

/// The planner's settings or models are not the worker's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Differs {
    /// The settings.
    #[error(
        "the worker runs with other settings ({found:016x}) than this config file states \
         ({expected:016x}): use the worker's file, or restart the worker with this one"
    )]
    Settings {
        /// Hash of the worker's settings.
        found: u64,
        /// Hash of this process's.
        expected: u64,
    },
    /// A model.
    #[error(
        "the worker runs platform {platform} with model {found:016x}, this config file names model \
         {expected:016x}: use the worker's file and models, or restart the worker"
    )]
    Model {
        /// The platform, or the number of platforms if only a hash of all is known.
        platform: String,
        /// Hash of the worker's model.
        found: u64,
        /// Hash of this process's.
        expected: u64,
    },
}
