//! The six trials: one robot driven through each protocol, alone in the arena.

use std::path::PathBuf;

use joulebus_dataset::trial::Trial;
use joulebus_plant::arena::{STEP_S, saturated};
use joulebus_plant::body::Body;
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::{Driver, Protocol, SAMPLES, UnknownTrial};
use joulebus_statistics::noise::Noise;

use crate::recorder::Recorder;

/// Random streams: manufacturing variation of a robot, its state in a trial, its motion.
pub(crate) const MADE: u64 = 1 << 32;
const STATE: u64 = 2 << 32;
const MOTION: u64 = 3 << 32;

/// Id of the robot that drives all six trials. The scenario's seven have other ids.
const TRIAL_ROBOT: u32 = 8;

/// Drives the robot of `seed` through a protocol: [`SAMPLES`] rows, [`STEP_S`] apart.
///
/// A row holds the command during a step, and pose and reading at its end. The six trials of a
/// seed are of the same robot. Its battery, its temperature and all random state restart in
/// each. `Trial::path` marks it as simulated. No file is read or written.
pub fn drive(protocol: Protocol, seed: u64) -> Trial {
    drive_with(protocol, Parts::default(), seed, SAMPLES)
}

/// Same as [`drive`], with other parameters and length, at least two samples.
pub fn drive_with(protocol: Protocol, parts: Parts, seed: u64, samples: usize) -> Trial {
    let mut made = Noise::new(seed, MADE + u64::from(TRIAL_ROBOT));
    let state = Noise::new(seed, STATE + protocol.number() as u64);
    let motion = Noise::new(seed, MOTION + protocol.number() as u64);
    let (mut driver, pose) = Driver::new(protocol, motion);
    let mut body = Body::new(parts, 0.0, 0, pose, &mut made, state);
    let mut recorder = Recorder::with_capacity(samples);
    for step in 0..samples.max(2) {
        let (phase, command) = driver.next(STEP_S, body.pose);
        recorder.step(&mut body, step, phase, saturated(command));
    }
    let path = PathBuf::from(format!("simulated/{}.npy", protocol.file_stem()));
    recorder.finish(&path, TRIAL_ROBOT)
}

/// Trial `number` (1 to 6) of `seed`: see [`drive`].
///
/// # Errors
/// [`UnknownTrial`].
pub fn trial(number: usize, seed: u64) -> Result<Trial, UnknownTrial> {
    Ok(drive(Protocol::of_trial(number)?, seed))
}

/// All six trials of `seed`, in order.
pub fn trials(seed: u64) -> Vec<Trial> {
    Protocol::ALL.map(|protocol| drive(protocol, seed)).into()
}
