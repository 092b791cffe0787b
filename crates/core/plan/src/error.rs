//! Errors of asking.

use joulebus_wire::QueryRefusal;

/// Errors of a question. Candidates, steps and points count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum AskError {
    /// The numbers of commands do not match.
    #[error(
        "{found} values in {column}: allowed are {allowed}, as many for each of {candidates} \
         candidates in both columns"
    )]
    Shape { column: &'static str, found: usize, allowed: usize, candidates: usize },
    /// No candidate, or none with a step.
    #[error("{candidates} candidates of {steps} steps: at least one of each is needed")]
    Empty { candidates: usize, steps: usize },
    /// Too many steps.
    #[error(
        "{found} steps: allowed are {allowed} a candidate or path. Use a longer period, or a \
            shorter path"
    )]
    Steps { found: usize, allowed: usize },
    /// The period of the commands.
    #[error("a period of {found} s: allowed is more than 0 and at most {allowed} s")]
    Period { found: f32, allowed: f32 },
    /// A command that is not a number, or that the platform cannot follow.
    #[error(
        "{column} of candidate {candidate}, step {step} is {found:?}: platform {platform} follows \
         −{allowed} to {allowed} (`v_max_mps`, `omega_max_radps` in its config)"
    )]
    Command {
        column: &'static str,
        candidate: usize,
        step: usize,
        found: f32,
        platform: String,
        allowed: f32,
    },
    /// Too many moments.
    #[error("{found} moments along the plan: allowed are {allowed}")]
    Moments { found: usize, allowed: usize },
    /// The coverage.
    #[error("a coverage of {found}: allowed are 0.5 to 0.999")]
    Coverage { found: f32 },
    /// A duration.
    #[error("a duration of {found} s: allowed is more than 0 and at most {allowed} s")]
    Duration { found: f32, allowed: f32 },
    /// The length of a slice for results.
    #[error("memory for {found} results: {allowed} are needed")]
    Results { found: usize, allowed: usize },
    /// The path.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// Errors of answering a [`crate::Question`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum QuestionError {
    /// A robot that is not in the fleet.
    #[error(
        "robot {robot} is not in the fleet: its source must publish samples of it (`joulebus watch --once` \
         lists the robots)"
    )]
    UnknownRobot { robot: u32 },
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

/// Errors of turning a path into commands. Points count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum PathError {
    /// Fewer than two points.
    #[error(
        "a path of {found} points: at least two are needed, where the robot is and where it goes"
    )]
    Points { found: usize },
    /// A coordinate that is not a number, or too far away.
    #[error("{column} of point {point} is {found:?}: allowed are −{allowed} to {allowed}")]
    Coordinate { column: &'static str, point: usize, found: f64, allowed: f64 },
    /// A column that has neither no value nor one for each point.
    #[error("{column} has {found} values: allowed are none or {allowed}, one for each point")]
    Column { column: &'static str, found: usize, allowed: usize },
    /// A value that is not a number, or out of bounds.
    #[error("{column} of point {point} is {found:?}: allowed are {} to {}", allowed.0, allowed.1)]
    Value { column: &'static str, point: usize, found: f64, allowed: (f64, f64) },
    /// A time before that of the point before.
    #[error("point {point} has the time {found} s, the point before {before} s: times never fall")]
    Falls { point: usize, found: f64, before: f64 },
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
    Tolerance { found: f32, allowed: f32 },
    /// A speed that is not above 0.
    #[error("a speed of {found} m/s towards point {point}: it must be above 0")]
    Speed { point: usize, found: f64 },
    /// A speed above the platform's.
    #[error(
        "a speed of {found} m/s towards point {point}: platform {platform} drives at most {allowed} m/s \
         (`v_max_mps` in its config). Ask for that or less, or for no speed: then it is the highest \
         that the model knows"
    )]
    TooFast { point: usize, found: f64, platform: String, allowed: f32 },
    /// A load that no reading of the platform can contain.
    #[error(
        "a load of {found} W towards point {point}, and while it waits there: at most {allowed} W lie between the readings that \
         platform {platform} allows (`power_min_w`, `power_max_w` in its config). Loads are in W"
    )]
    Load { point: usize, found: f64, platform: String, allowed: f64 },
    /// The platform cannot be commanded to move.
    #[error(
        "platform {platform} allows {v_max_mps} m/s and {omega_max_radps} rad/s: a path needs both \
         above 0 (`v_max_mps`, `omega_max_radps` in its config)"
    )]
    Immobile { platform: String, v_max_mps: f32, omega_max_radps: f32 },
    /// The path takes more steps than are allowed.
    #[error(
        "point {point} is still {distance_m:.2} m away after {allowed} steps, as many as a path may have: give it a \
         higher speed, or a shorter path"
    )]
    TooLong { point: usize, distance_m: f64, allowed: usize },
    /// The path takes more steps than are allowed, because the robot waits.
    #[error(
        "a wait of {found_s} s at point {point}: a path may take {allowed_s} s in all. Ask about the rest after \
         the wait"
    )]
    Waits { point: usize, found_s: f64, allowed_s: f64 },
    /// The follower does not get there.
    #[error(
        "point {point} is still {distance_m:.2} m away after {steps} steps: give it a lower speed, or \
         more distance to the one before"
    )]
    NotReached { point: usize, distance_m: f64, steps: usize },
}

/// The planner's settings or models are not the worker's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum Differs {
    /// The settings.
    #[error(
        "the worker runs with other settings ({found:016x}) than this config file states \
         ({expected:016x}): use the worker's file, or restart the worker with this one"
    )]
    Settings { found: u64, expected: u64 },
    /// A model.
    #[error(
        "the worker runs platform {platform} with model {found:016x}, this config file names model \
         {expected:016x}: use the worker's file and models, or restart the worker"
    )]
    Model {
        /// The platform, or the number of platforms if only a hash of all is known.
        platform: String,
        found: u64,
        expected: u64,
    },
}
