//! One robot driven through a protocol.

use std::path::PathBuf;

use joulebus_dataset::trial::Trial;
use joulebus_statistics::noise::Noise;

use super::motion::Motion;
use super::{Protocol, SAMPLES, TRIAL_ROBOT, UnknownTrial, plan};
use crate::arena::{Command, Pose, STEP_S, saturated};
use crate::body::Body;
use crate::parts::Parts;
use crate::recorder::Recorder;

/// Random streams: manufacturing variation of a robot, its state in a trial, its motion.
pub(crate) const MADE: u64 = 1 << 32;
const STATE: u64 = 2 << 32;
const MOTION: u64 = 3 << 32;

/// A controller that drives a robot through a protocol, again and again.
#[derive(Clone, Debug)]
pub(crate) struct Driver {
    protocol: Protocol,
    motion: Motion,
    noise: Noise,
}

impl Driver {
    /// A driver, and the pose in which its robot begins: in the centre, with a random heading.
    pub(crate) fn new(protocol: Protocol, mut noise: Noise) -> (Self, Pose) {
        let pose = Pose {
            theta_rad: noise.between(-std::f64::consts::PI, std::f64::consts::PI),
            ..Pose::default()
        };
        let motion = Motion::new(protocol, 0);
        let driver = Self {
            protocol,
            motion,
            noise,
        };
        (driver, pose)
    }

    /// Phase and commanded velocities at a pose, for the next `dt_s` seconds.
    pub(crate) fn next(&mut self, dt_s: f64, pose: Pose) -> (u32, Command) {
        self.motion.next(dt_s, pose, &mut self.noise)
    }

    /// Begins in the middle of the protocol, with a random segment.
    pub(crate) fn begin_anywhere(&mut self) {
        let segment = self.noise.below(plan::segments(self.protocol));
        self.motion = Motion::new(self.protocol, segment);
    }

    /// Goes on to the protocol of the next trial, after the last one to the first.
    pub(crate) fn begin_next(&mut self) {
        let next = self.protocol.number() % Protocol::ALL.len();
        self.protocol = Protocol::ALL[next];
        self.motion = Motion::new(self.protocol, 0);
    }
}

impl Protocol {
    /// Drives the robot of `seed` through the protocol: [`SAMPLES`] rows, [`STEP_S`] apart.
    ///
    /// A row holds the command during a step, and pose and reading at its end. The six trials of a
    /// seed are of the same robot; its battery, its temperature and all random state restart in
    /// each. `Trial::path` marks it as simulated; no file is read or written.
    #[must_use]
    pub fn trial(self, seed: u64) -> Trial {
        self.trial_with(Parts::default(), seed, SAMPLES)
    }

    /// As [`Protocol::trial`], with other parameters and length, at least two samples.
    #[must_use]
    pub fn trial_with(self, parts: Parts, seed: u64, samples: usize) -> Trial {
        let mut made = Noise::new(seed, MADE + u64::from(TRIAL_ROBOT));
        let state = Noise::new(seed, STATE + self.number() as u64);
        let motion = Noise::new(seed, MOTION + self.number() as u64);
        let (mut driver, pose) = Driver::new(self, motion);
        let mut body = Body::new(parts, 0.0, 0, pose, &mut made, state);
        let mut recorder = Recorder::with_capacity(samples);
        for step in 0..samples.max(2) {
            let (phase, command) = driver.next(STEP_S, body.pose);
            recorder.step(&mut body, step, phase, saturated(command));
        }
        let path = PathBuf::from(format!("simulated/{}.npy", self.file_stem()));
        recorder.finish(&path, TRIAL_ROBOT)
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
