//! One robot driven through a protocol.

use std::path::PathBuf;

use joulebus_dataset::trial::Trial;
use joulebus_statistics::noise::Noise;

use super::motion::Motion;
use super::{Protocol, SAMPLES, TRIAL_ROBOT, UnknownTrial};
use crate::arena::{Pose, saturated};
use crate::body::Body;
use crate::parts::Parts;
use crate::recorder::Recorder;

/// Random streams: manufacturing variation of a robot, its state in a trial, its motion.
pub(crate) const MADE: u64 = 1 << 32;
const STATE: u64 = 2 << 32;
const MOTION: u64 = 3 << 32;

impl Protocol {
    /// Drives the robot of `seed` through the protocol: [`SAMPLES`] rows, [`STEP_S`](crate::arena::STEP_S) apart.
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
