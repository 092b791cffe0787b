//! The six motion protocols: one robot alone in the arena, 8,000 samples each.
//!
//! The published dataset names its trials (structured motion, goal navigation, acceleration,
//! extremes, random walk, steady state) and the mean and spread of its commands: v 0.0279 ±
//! 0.0736 m/s, ω 0.0479 ± 1.0187 rad/s. How the robots were driven within each is not published in
//! a form that could be read for this work; the protocols here are plausible ones of those names,
//! with speeds chosen to give that mean and spread.

mod motion;

use std::fmt;
use std::path::PathBuf;

use super::arena::{Pose, saturated};
use super::body::Body;
use super::parts::Parts;
use super::recorder::Recorder;
use joulebus_dataset::trial::Trial;
use joulebus_statistics::noise::Noise;
use motion::Motion;

/// Samples of a trial.
pub const SAMPLES: usize = 8_000;
/// Id of the robot that drives all six trials; the scenario's seven have other ids.
pub const TRIAL_ROBOT: u32 = 8;

/// How the robot is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Trial 1: straight there and back, turns on the spot, arcs, rests; each at several speeds.
    Structured,
    /// Trial 2: from one random goal to the next, with a rest at each.
    GoalNavigation,
    /// Trial 3: ramps of v and of ω of several steepnesses.
    Acceleration,
    /// Trial 4: full speeds and full turns, with sudden reversals.
    Extremes,
    /// Trial 5: random velocities held for random times.
    RandomWalk,
    /// Trial 6: constant velocities held long.
    SteadyState,
}

/// A number that is no trial's.
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

    /// The name in the published files' names.
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

    /// The trial's file name without ending, as published.
    #[must_use]
    pub fn file_stem(self) -> String {
        format!("energy_data_trial{}_{}", self.number(), self.name())
    }

    /// Drives the robot of `seed` through the protocol: [`SAMPLES`] rows, [`STEP_S`](super::arena::STEP_S) apart.
    ///
    /// A row holds the command in force during a step, and pose and reading at its end. The six
    /// trials of a seed are of the same robot; its battery, its temperature and everything random
    /// begin anew in each. `Trial::path` says that it is simulated; nothing is read or written.
    #[must_use]
    pub fn trial(self, seed: u64) -> Trial {
        self.trial_with(Parts::default(), seed, SAMPLES)
    }

    /// As [`Protocol::trial`], of other parts and length, at least two samples.
    #[must_use]
    pub fn trial_with(self, parts: Parts, seed: u64, samples: usize) -> Trial {
        let mut made = Noise::new(seed, MADE + u64::from(TRIAL_ROBOT));
        let state = Noise::new(seed, STATE + self.number() as u64);
        let mut noise = Noise::new(seed, MOTION + self.number() as u64);
        let pose = Pose {
            theta_rad: noise.between(-std::f64::consts::PI, std::f64::consts::PI),
            ..Pose::default()
        };
        let mut body = Body::new(parts, 0.0, 0, pose, &mut made, state);
        let mut motion = Motion::new(self);
        let mut recorder = Recorder::with_capacity(samples);
        for step in 0..samples.max(2) {
            let (phase, command) = motion.next(body.pose, &mut noise);
            let command = saturated(command);
            recorder.step(&mut body, step, phase, command);
        }
        let path = PathBuf::from(format!("simulated/{}.npy", self.file_stem()));
        recorder.finish(&path, TRIAL_ROBOT)
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

/// Trial `number` (1 to 6) of `seed`: see [`Protocol::trial`].
///
/// # Errors
/// [`UnknownTrial`].
pub fn trial(number: usize, seed: u64) -> Result<Trial, UnknownTrial> {
    Ok(Protocol::of_trial(number)?.trial(seed))
}

/// All six trials of `seed`, in order.
#[must_use]
pub fn trials(seed: u64) -> Vec<Trial> {
    Protocol::ALL.map(|protocol| protocol.trial(seed)).into()
}

/// Streams of random numbers: what manufacturing gave a robot, its state in a trial, its motion.
pub(super) const MADE: u64 = 1 << 32;
const STATE: u64 = 2 << 32;
const MOTION: u64 = 3 << 32;
