//! Open-loop rollouts of command sequences.

use std::ops::Range;

use crate::error::{LengthError, RolloutError};
use crate::features::LAGS;
use crate::reading_age::ReadingAge;

/// State of a robot before the first step of its candidates.
///
/// [`Rollouts`] has an example.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RolloutStart {
    /// The command before the first step: linear velocity in m/s and angular velocity in rad/s.
    /// `None` if there was none. The derivatives of the first step are then 0.
    pub command: Option<(f32, f32)>,
    /// The last readings in watt, newest first.
    pub lag_w: [f32; LAGS],
    /// The age of the newest of them, for models with [`crate::Model::needs_freshness`]. From step
    /// to step it follows the schedule ([`ReadingAge::pass`]).
    pub reading_age: ReadingAge,
}

/// Candidate command sequences of any number of robots, all of the same length.
///
/// A *lane* is one candidate of one robot: lane `robot * candidates + candidate`. Commands are
/// stored step by step: the command of lane `l` at step `t` is at `t * lanes + l`, so that a step
/// of many lanes is contiguous in memory.
///
/// ```
/// use joulebus_predictor::{
///     LAGS, Model, Persistence, ReadingAge, ResidualStats, RolloutStart, Rollouts,
/// };
///
/// let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
/// let model = Model::Persistence(Persistence::new(residual)?);
/// let start = RolloutStart {
///     command: None,
///     lag_w: [4.0; LAGS],
///     reading_age: ReadingAge::UNKNOWN,
/// };
/// // One robot, two candidates of ten steps.
/// let rollouts = Rollouts {
///     starts: &[start],
///     candidates: 2,
///     steps: 10,
///     step_s: 0.5,
///     v_mps: &[0.2; 20],
///     omega_radps: &[0.0; 20],
/// };
/// let mut energy_j = [0.0; 2];
/// model.rollout(&rollouts, 0..2, &mut energy_j, None)?;
/// assert_eq!(energy_j, [20.0; 2]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Rollouts<'a> {
    /// Initial state of each robot.
    pub starts: &'a [RolloutStart],
    /// Candidates per robot.
    pub candidates: usize,
    /// Steps per candidate.
    pub steps: usize,
    /// Time between two steps in seconds, positive and finite.
    pub step_s: f32,
    /// Linear velocities in m/s, `steps * lanes`.
    pub v_mps: &'a [f32],
    /// Angular velocities in rad/s, `steps * lanes`.
    pub omega_radps: &'a [f32],
}

impl Rollouts<'_> {
    /// Robots times candidates. An overflow saturates: that number fits no slice and is refused
    /// later.
    pub fn lanes(&self) -> usize {
        self.starts.len().saturating_mul(self.candidates)
    }

    pub(crate) fn check(
        &self,
        lanes: &Range<usize>,
        energy_j: usize,
        power_w: Option<usize>,
    ) -> Result<(), RolloutError> {
        if !(self.step_s > 0.0 && self.step_s.is_finite()) {
            return Err(RolloutError::Step { found: self.step_s });
        }
        if lanes.start > lanes.end || lanes.end > self.lanes() {
            return Err(RolloutError::Lanes {
                start: lanes.start,
                end: lanes.end,
                allowed: self.lanes(),
            });
        }
        let commands = self.lanes().saturating_mul(self.steps);
        let trace = lanes.len().saturating_mul(self.steps);
        for (column, found, allowed) in [
            ("v_mps", self.v_mps.len(), commands),
            ("omega_radps", self.omega_radps.len(), commands),
            ("energy_j", energy_j, lanes.len()),
            ("power_w", power_w.unwrap_or(trace), trace),
        ] {
            if found != allowed {
                return Err(RolloutError::Length(LengthError { column, found, allowed }));
            }
        }
        Ok(())
    }
}
