//! The six motion protocols: one robot alone in the arena, 8,000 samples each.
//!
//! The published dataset names its trials (structured motion, goal navigation, acceleration,
//! extremes, random walk, steady state) and the mean and deviation of its commands: v 0.0279 ±
//! 0.0736 m/s, ω 0.0479 ± 1.0187 rad/s. The commands within each trial are not published in a form
//! that could be read for this work; the protocols here are plausible implementations of those
//! names, with speeds chosen to match that mean and deviation.

mod drive;
mod motion;

use std::fmt;

pub(crate) use drive::MADE;
pub use drive::{trial, trials};

/// Samples of a trial.
pub const SAMPLES: usize = 8_000;
/// Id of the robot that drives all six trials; the scenario's seven have other ids.
pub(crate) const TRIAL_ROBOT: u32 = 8;

/// A motion protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Trial 1: straight lines there and back, turns on the spot, arcs, rests; each at several
    /// speeds.
    Structured,
    /// Trial 2: from one random goal to the next, with a rest at each.
    GoalNavigation,
    /// Trial 3: ramps of v and of ω with several slopes.
    Acceleration,
    /// Trial 4: maximum speeds and turns, with sudden reversals.
    Extremes,
    /// Trial 5: random velocities held for random times.
    RandomWalk,
    /// Trial 6: constant velocities held long.
    SteadyState,
}

/// The number of no trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("trial {found}: allowed are 1 to 6")]
pub struct UnknownTrial {
    /// The number.
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
    #[must_use]
    pub const fn number(self) -> usize {
        self as usize + 1
    }

    /// The name used in the published files' names.
    #[must_use]
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
    #[must_use]
    pub fn file_stem(self) -> String {
        format!("energy_data_trial{}_{}", self.number(), self.name())
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}
