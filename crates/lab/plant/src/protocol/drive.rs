//! The controller of one robot.

use joulebus_statistics::noise::Noise;

use super::motion::Motion;
use super::segment::{BACKWARD_MPS, TURN_RADPS};
use super::{Protocol, plan};
use crate::arena::{Command, OMEGA_MAX_RADPS, Pose, V_MAX_MPS};

/// A controller that drives a robot through a protocol, again and again.
#[derive(Clone, Debug)]
pub struct Driver {
    protocol: Protocol,
    motion: Motion,
    noise: Noise,
    /// Factors of the protocol's v and ω.
    scale: (f64, f64),
}

impl Driver {
    /// A driver, and the pose in which its robot begins: in the centre, with a random heading.
    pub fn new(protocol: Protocol, mut noise: Noise) -> (Self, Pose) {
        let pose = Pose {
            theta_rad: noise.between(-std::f64::consts::PI, std::f64::consts::PI),
            ..Pose::default()
        };
        let motion = Motion::new(protocol, 0);
        let driver = Self { protocol, motion, noise, scale: (1.0, 1.0) };
        (driver, pose)
    }

    /// Phase and commanded velocities at a pose, for the next `dt_s` seconds.
    pub fn next(&mut self, dt_s: f64, pose: Pose) -> (u32, Command) {
        let (phase, command) = self.motion.next(dt_s, pose, &mut self.noise);
        let scaled = Command {
            v_mps: self.scale.0 * command.v_mps,
            omega_radps: self.scale.1 * command.omega_radps,
        };
        (phase, scaled)
    }

    /// Scales the protocol so that each of its extremes is at least what the wheels are capable of.
    #[must_use]
    pub fn at_full_speed(mut self) -> Self {
        self.scale = (V_MAX_MPS / -BACKWARD_MPS, OMEGA_MAX_RADPS / TURN_RADPS);
        self
    }

    /// Begins in the middle of the protocol, with a random segment.
    pub fn begin_anywhere(&mut self) {
        let segment = self.noise.below(plan::segments(self.protocol));
        self.motion = Motion::new(self.protocol, segment);
    }

    /// Goes on to the protocol of the next trial, after the last one to the first.
    pub fn begin_next(&mut self) {
        let next = self.protocol.number() % Protocol::ALL.len();
        self.protocol = Protocol::ALL[next];
        self.motion = Motion::new(self.protocol, 0);
    }
}
