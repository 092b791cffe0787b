//! The Robotarium: arena, control period, and robot kinematics.

use std::f64::consts::TAU;
use std::ops::{Add, Mul, Sub};

/// A position in m, or a velocity in m/s: (x, y), x along the long side.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Vector {
    /// Component along the long side.
    pub x: f64,
    /// Component along the short side.
    pub y: f64,
}

impl Vector {
    /// The vector of two components.
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// Its length.
    pub fn norm(self) -> f64 {
        libm::sqrt(self.x * self.x + self.y * self.y)
    }
}

impl Add for Vector {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y)
    }
}

impl Sub for Vector {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y)
    }
}

impl Mul<f64> for Vector {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self::new(self.x * factor, self.y * factor)
    }
}

/// Maximum commanded linear velocity, m/s.
pub const V_MAX_MPS: f64 = 0.2;
/// Maximum commanded angular velocity, rad/s: both wheels at [`V_MAX_MPS`], in opposite directions.
pub const OMEGA_MAX_RADPS: f64 = 2.0 * V_MAX_MPS / ROBOT_M;
/// Control period, s.
pub const STEP_S: f64 = 0.033;
/// Half of the arena's sides, m: the origin is the centre, x runs along the long side.
pub const HALF_ARENA_M: (f64, f64) = (1.6, 1.0);
/// Diameter and track width of a robot, m.
pub const ROBOT_M: f64 = 0.11;

/// The current command.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Command {
    /// Linear velocity, m/s.
    pub v_mps: f64,
    /// Angular velocity, counterclockwise, rad/s.
    pub omega_radps: f64,
}

/// Pose of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Pose {
    /// Position, m.
    pub at_m: Vector,
    /// Heading from the x axis, rad, within ±π.
    pub theta_rad: f64,
}

/// Speeds of the left and the right wheel, m/s.
pub fn wheels_mps(command: Command) -> [f64; 2] {
    let turn_mps = command.omega_radps * ROBOT_M / 2.0;
    [command.v_mps - turn_mps, command.v_mps + turn_mps]
}

/// The command after wheel saturation: each wheel's speed is clamped to ±[`V_MAX_MPS`] separately,
/// as on the testbed, and the command follows from the clamped speeds.
pub fn saturated(command: Command) -> Command {
    let [left_mps, right_mps] =
        wheels_mps(command).map(|speed_mps| speed_mps.clamp(-V_MAX_MPS, V_MAX_MPS));
    Command { v_mps: (left_mps + right_mps) / 2.0, omega_radps: (right_mps - left_mps) / ROBOT_M }
}

/// The unit vector of an angle from the x axis.
pub fn direction(angle_rad: f64) -> Vector {
    let (sin, cos) = libm::sincos(angle_rad);
    Vector::new(cos, sin)
}

impl Pose {
    /// The pose after `dt_s` seconds of a command, integrated with the heading at the midpoint.
    #[must_use]
    pub fn driven(self, command: Command, dt_s: f64) -> Self {
        let Command { v_mps, omega_radps } = command;
        let middle_rad = self.theta_rad + 0.5 * omega_radps * dt_s;
        Self {
            at_m: self.at_m + direction(middle_rad) * (v_mps * dt_s),
            theta_rad: wrapped(self.theta_rad + omega_radps * dt_s),
        }
    }
}

/// The angle wrapped to ±π, for angles that are at most a few turns off.
pub(crate) fn wrapped(angle_rad: f64) -> f64 {
    angle_rad - TAU * libm::round(angle_rad / TAU)
}
