//! What would these commands cost? The model fed with its own forecasts.

use crate::network::canonical;
use crate::{LAGS, Model, ReadingAge, RolloutError};
use std::ops::Range;

/// Where a robot stands before the first step of its candidates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RolloutStart {
    /// The command in force before the first step: linear velocity in m/s and angular velocity in
    /// rad/s. `None` if there was none; the derivatives of the first step are then 0.
    pub command: Option<(f32, f32)>,
    /// The last readings in watt, newest first.
    pub lag_w: [f32; LAGS],
    /// How fresh the newest of them is; read by models that ask for it
    /// ([`Model::needs_freshness`]). From step to step it goes by the schedule
    /// ([`ReadingAge::pass`]).
    pub reading_age: ReadingAge,
}

/// Candidate command sequences of any number of robots, all of the same length.
///
/// A *lane* is one candidate of one robot: lane `robot * candidates + candidate`. Commands are
/// columns step by step: the command of lane `l` at step `t` stands at `t * lanes + l`, so that a
/// step of many lanes is one stretch of memory.
#[derive(Clone, Copy, Debug)]
pub struct Rollouts<'a> {
    /// Where each robot stands.
    pub starts: &'a [RolloutStart],
    /// Candidates of each robot.
    pub candidates: usize,
    /// Steps of each candidate.
    pub steps: usize,
    /// Time between two steps in seconds, positive and finite.
    pub step_s: f32,
    /// Linear velocities in m/s, `steps * lanes`.
    pub v_mps: &'a [f32],
    /// Angular velocities in rad/s, `steps * lanes`.
    pub omega_radps: &'a [f32],
}

impl Rollouts<'_> {
    /// Robots times candidates. Saturates; a number that large fits no slice and is refused later.
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
                return Err(RolloutError::Length {
                    column,
                    found,
                    allowed,
                });
            }
        }
        Ok(())
    }
}

impl Model {
    /// Runs the candidates of `lanes` and writes the energy of each in joule, and if wanted its
    /// forecast of every step in watt (step by step: `power_w[t * lanes.len() + l]`).
    ///
    /// At each step the model sees the command of that step, the derivatives over `step_s`, and as
    /// lag window its own forecasts, with the robot's readings behind them. The bits are those of
    /// [`Model::predict`] called step by step by hand with rows of [`features`](crate::features()); the energy is
    /// `step_s` times the sum of the forecasts in step order, both in double precision, rounded
    /// once. A lane with a command or reading that is not finite gives results that are not finite
    /// from that step on, and changes no other lane.
    ///
    /// `lanes` is a part of `0..rollouts.lanes()`, so that threads can share the work: the outputs
    /// are those of the part alone. Allocates nothing.
    pub fn rollout(
        &self,
        rollouts: &Rollouts<'_>,
        lanes: Range<usize>,
        energy_j: &mut [f32],
        power_w: Option<&mut [f32]>,
    ) -> Result<(), RolloutError> {
        rollouts.check(&lanes, energy_j.len(), power_w.as_deref().map(<[f32]>::len))?;
        match self {
            Model::Network(network) => {
                network.rollout(rollouts, lanes.start, energy_j, power_w);
            }
            Model::Persistence(_) => repeat(rollouts, lanes, energy_j, power_w),
        }
        Ok(())
    }
}

/// Persistence fed with its own forecasts: the newest reading for ever.
fn repeat(
    rollouts: &Rollouts<'_>,
    lanes: Range<usize>,
    energy_j: &mut [f32],
    mut power_w: Option<&mut [f32]>,
) {
    let count = lanes.len();
    for (index, lane) in lanes.enumerate() {
        let [newest_w, ..] = rollouts.starts[lane / rollouts.candidates].lag_w;
        let mut sum_w = 0.0f64;
        for step in 0..rollouts.steps {
            sum_w += f64::from(newest_w);
            if let Some(power_w) = power_w.as_deref_mut() {
                power_w[step * count + index] = newest_w;
            }
        }
        energy_j[index] = canonical((sum_w * f64::from(rollouts.step_s)) as f32);
    }
}
