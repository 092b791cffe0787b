//! The six motion protocols: one robot alone in the arena, 8,000 samples each.
//!
//! What each trial drives is the paper's (arXiv 2603.13908): the eight phases of trial 1 in turn,
//! goals with proportional control, ramps of several slopes, the greatest and least velocities with
//! rapid reversals, uniform velocities reached smoothly, long segments at constant velocity.
//! Commands from −0.15 to 0.16 m/s and up to ±3.14 rad/s. The order and length of the segments
//! within a trial are not published. They are chosen so that mean and deviation of all commands are
//! about the published ones (v 0.0279 ± 0.0736 m/s, ω 0.0479 ± 1.0187 rad/s).

mod drive;
mod motion;
mod plan;
mod segment;

use std::fmt;

use crate::arena::STEP_S;
pub use drive::Driver;

/// Samples of a trial.
pub const SAMPLES: usize = 8_000;
/// Length of a trial, s.
pub const TRIAL_S: f64 = SAMPLES as f64 * STEP_S;
/// A motion protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Trial 1, eight phases in turn: idle, forward and backward, lateral movement, circular arcs,
    /// sinusoidal paths, velocity ramps, step changes, figures of eight.
    Structured,
    /// Trial 2: from one random goal to the next by proportional control, with a rest at each.
    GoalNavigation,
    /// Trial 3: v and ω rise and fall at several rates.
    Acceleration,
    /// Trial 4: greatest and least velocities, with rapid reversals.
    Extremes,
    /// Trial 5: velocities drawn uniformly, reached smoothly.
    RandomWalk,
    /// Trial 6: long segments at constant velocity.
    SteadyState,
}

/// The number of no trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("trial {found}: allowed are 1 to 6")]
#[allow(missing_docs)] // The messages name the fields.
pub struct UnknownTrial {
    pub found: usize,
}

impl Protocol {
    /// All six, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::Structured,
        Self::GoalNavigation,
        Self::Acceleration,
        Self::Extremes,
        Self::RandomWalk,
        Self::SteadyState,
    ];

    /// The protocol of a trial's number, 1 to 6.
    ///
    /// # Errors
    /// [`UnknownTrial`].
    pub fn of_trial(number: usize) -> Result<Self, UnknownTrial> {
        number
            .checked_sub(1)
            .and_then(|index| Self::ALL.get(index).copied())
            .ok_or(UnknownTrial { found: number })
    }

    /// The trial's number, 1 to 6.
    pub const fn number(self) -> usize {
        self as usize + 1
    }

    /// The name used in the published files' names.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Structured => "structured",
            Self::GoalNavigation => "goal_navigation",
            Self::Acceleration => "acceleration",
            Self::Extremes => "extremes",
            Self::RandomWalk => "random_walk",
            Self::SteadyState => "steady_state",
        }
    }

    /// The trial's file name without extension, as published.
    pub fn file_stem(self) -> String {
        format!("energy_data_trial{}_{}", self.number(), self.name())
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}
