//! The unicycle follower that turns paths into commands.
//!
//! The robot heads for the farthest point of the path that it sees: it could drive there in a
//! straight line and pass each vertex in between within 2.5 cm. With d the distance to that point, e
//! the angle from the heading to its direction, and s the requested speed, at most the platform's,
//!
//! ```text
//! u = min(s, 0.8/s · d)
//! v = u cos e
//! ω = 2/s · e
//! ```
//!
//! each within the platform's limits. Where the caller does not ask for a speed, they are also
//! within what the model has learned of commands: with an infinite speed, while the robot turns,
//! and backwards. Samples may have any command that the platform takes.
//!
//! The *shape* of the path decides, not the number of its points. Only a point at which the
//! direction or the speed changes is a vertex. Repeated points, and points on a straight line of one
//! speed, are none. Before a sharp corner the robot sees the corner only: it slows down, and sees
//! the next leg within 5 cm of the corner. In a curve it sees along the curve, and drives without a
//! stop, at most as fast as it can turn there. It turns while it drives, and drives backwards if the
//! point is behind it. The path ends within 5 cm of its last point.
//!
//! A leg ends when the robot is within 5 cm of its point, or has passed it. The gains are those of
//! the Robotarium simulator's position controllers.

use std::f64::consts::PI;

use serde::Serialize;

use crate::error::PathError;
use crate::limits::MAX_STEPS;
use crate::path::{Path, Point, REACH_M, distance_m};
use crate::platform::Platform;
use crate::shape::{Ahead, Shape};

/// Speed per distance, 1/s.
const GAIN: f64 = 0.8;
/// Angular velocity per angle, 1/s.
const TURN_GAIN: f64 = 2.0;
/// A leg may take this much longer than at its speed.
const PATIENCE: f64 = 20.0;

/// A robot's position and heading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pose {
    /// Position.
    pub at: Point,
    /// Heading, rad, counter-clockwise from east.
    pub heading_rad: f64,
}

/// Commands of a path.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Followed {
    /// Time that each command is in force, s.
    pub period_s: f32,
    /// Linear velocities, m/s.
    pub v_mps: Vec<f32>,
    /// Angular velocities, rad/s.
    pub omega_radps: Vec<f32>,
    /// Steps up to the end of each leg, by the path's own points. Legs may end with the same step,
    /// and with 0 steps at the first point.
    pub leg_ends: Vec<usize>,
    /// Pose before each step, and after the last.
    pub poses: Vec<Pose>,
}

/// Drives a unicycle along paths, within a platform's limits and at its rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    platform: String,
    period_s: f64,
    v_max_mps: f32,
    /// Greatest velocities that the model knows, within the platform's limits: forwards and
    /// backwards, m/s, and turning, rad/s.
    known_mps: f32,
    back_max_mps: f32,
    omega_max_radps: f32,
    max_steps: usize,
}

impl Follower {
    /// A follower for a platform.
    ///
    /// # Errors
    /// [`PathError::Immobile`]: it cannot be commanded to drive and to turn.
    pub fn new(platform: &Platform) -> Result<Self, PathError> {
        let settings = &platform.settings;
        let (v_max_mps, omega_max_radps) = (settings.v_max_mps, settings.omega_max_radps);
        if !(v_max_mps > 0.0 && omega_max_radps > 0.0) {
            return Err(PathError::Immobile {
                platform: settings.name.clone(),
                v_max_mps,
                omega_max_radps,
            });
        }
        let [backwards, forwards] = platform.energy.v_mps;
        let [right, left] = platform.energy.omega_radps;
        // What the model does not know at all is answered as what is outside its training data.
        let known = |known: f32, limit: f32| if known > 0.0 { known.min(limit) } else { limit };
        Ok(Self {
            platform: settings.name.clone(),
            period_s: settings.period_ns as f64 * 1e-9,
            v_max_mps,
            known_mps: known(forwards, v_max_mps),
            back_max_mps: (-backwards).clamp(0.0, v_max_mps),
            omega_max_radps: known(left.min(-right), omega_max_radps),
            max_steps: MAX_STEPS,
        })
    }

    /// With at most this many steps a path, itself at most [`MAX_STEPS`].
    #[must_use]
    pub fn within(mut self, max_steps: usize) -> Self {
        self.max_steps = max_steps.min(MAX_STEPS);
        self
    }

    pub(crate) const fn max_steps(&self) -> usize {
        self.max_steps
    }

    /// The platform's name.
    #[must_use]
    pub fn platform(&self) -> &str {
        &self.platform
    }

    /// The commands of a path. A speed above the platform's is driven as the platform's.
    ///
    /// # Errors
    /// A path with values that are not allowed, or a point that is not reached.
    pub fn follow(&self, path: &Path) -> Result<Followed, PathError> {
        path.check()?;
        let shape = Shape::new(path);
        let mut followed = Followed {
            period_s: self.period_s as f32,
            v_mps: Vec::new(),
            omega_radps: Vec::new(),
            leg_ends: Vec::with_capacity(path.legs()),
            poses: vec![start(path, &shape)],
        };
        // The vertex beyond which the robot has looked.
        let mut seen = 0;
        for vertex in 1..shape.count() {
            seen = self.drive(&mut followed, path, (&shape, vertex), seen)?;
        }
        // Points in the place of the last vertex.
        let steps = followed.v_mps.len();
        followed.leg_ends.resize(path.legs(), steps);
        // The robot stops, so that a path to its own position has a step.
        let last = followed.poses[steps];
        self.push(&mut followed, last, (0.0, 0.0));
        if let Some(end) = followed.leg_ends.last_mut() {
            *end += 1;
        }
        Ok(followed)
    }

    /// Drives until a vertex is reached, or passed on the way to one that is `seen` beyond it.
    /// Returns the last vertex that the robot has seen.
    fn drive(
        &self,
        to: &mut Followed,
        path: &Path,
        (shape, vertex): (&Shape<'_>, usize),
        mut seen: usize,
    ) -> Result<usize, PathError> {
        let (at, speed_mps) = (shape.at(vertex), self.speed_mps(shape.speed_mps(vertex)));
        let begun = to.v_mps.len();
        let first_m = distance_m(to.poses[begun].at, at);
        let turn_s = PI / f64::from(self.omega_max_radps).min(TURN_GAIN);
        let patience_s = PATIENCE * (first_m / speed_mps + turn_s + 10.0 / GAIN);
        let most = (patience_s / self.period_s) as usize;
        loop {
            let steps = to.v_mps.len();
            let pose = to.poses[steps];
            let is_reached = distance_m(pose.at, at) <= REACH_M
                || (seen > vertex && shape.is_behind(pose.at, vertex));
            // Legs end in their order: those up to the vertex with it, at the latest.
            while let point = to.leg_ends.len() + 1
                && (point < shape.index(vertex) || (is_reached && point == shape.index(vertex)))
                && (is_reached
                    || distance_m(pose.at, path.points[point]) <= REACH_M
                    || shape.is_abeam(pose.at, point, vertex))
            {
                to.leg_ends.push(steps);
            }
            if is_reached {
                return Ok(seen);
            }
            let point = to.leg_ends.len() + 1;
            let distance_m = distance_m(pose.at, path.points[point]);
            if steps >= self.max_steps {
                return Err(PathError::TooLong { point, distance_m, allowed: self.max_steps });
            }
            if steps - begun >= most {
                return Err(PathError::NotReached { point, distance_m, steps: steps - begun });
            }
            let ahead = shape.ahead(pose.at, vertex, speed_mps / GAIN);
            seen = ahead.vertex;
            let speed_mps = if seen > vertex {
                speed_mps.min(self.turning_mps(&pose, &ahead))
            } else {
                speed_mps
            };
            self.push(to, pose, self.command(&pose, ahead.goal, speed_mps));
        }
    }

    /// The speed at which the robot can turn enough to reach the point ahead on an arc, m/s.
    fn turning_mps(&self, pose: &Pose, ahead: &Ahead) -> f64 {
        let chord_m = distance_m(pose.at, ahead.goal);
        let sine = libm::sin(error_rad(pose, ahead.goal)).abs();
        f64::from(self.omega_max_radps) * chord_m / (2.0 * sine).max(f64::MIN_POSITIVE)
    }

    /// The speed that is driven if one is asked for, m/s.
    fn speed_mps(&self, asked_mps: f64) -> f64 {
        let limit_mps = if asked_mps.is_finite() { self.v_max_mps } else { self.known_mps };
        asked_mps.min(limit_mps.into())
    }

    /// The command towards a point: m/s and rad/s, within the limits.
    #[must_use]
    pub fn command(&self, pose: &Pose, goal: Point, speed_mps: f64) -> (f32, f32) {
        let error_rad = error_rad(pose, goal);
        let along_mps = self.speed_mps(speed_mps).min(GAIN * distance_m(pose.at, goal));
        let v_mps = (along_mps * libm::cos(error_rad)) as f32;
        let omega_radps = (TURN_GAIN * error_rad) as f32;
        (
            v_mps.max(-self.back_max_mps),
            omega_radps.clamp(-self.omega_max_radps, self.omega_max_radps),
        )
    }

    fn push(&self, to: &mut Followed, pose: Pose, (v_mps, omega_radps): (f32, f32)) {
        let (v, omega) = (f64::from(v_mps), f64::from(omega_radps));
        // The middle of the arc.
        let middle_rad = pose.heading_rad + 0.5 * omega * self.period_s;
        let along_m = v * self.period_s;
        to.v_mps.push(v_mps);
        to.omega_radps.push(omega_radps);
        to.poses.push(Pose {
            at: Point {
                x_m: pose.at.x_m + along_m * libm::cos(middle_rad),
                y_m: pose.at.y_m + along_m * libm::sin(middle_rad),
            },
            heading_rad: wrap(pose.heading_rad + omega * self.period_s),
        });
    }
}

/// The robot at a path's first point. It faces the next vertex unless the path states a heading.
fn start(path: &Path, shape: &Shape<'_>) -> Pose {
    let at = path.points[0];
    let second = shape.at(1.min(shape.count() - 1));
    let towards = libm::atan2(second.y_m - at.y_m, second.x_m - at.x_m);
    Pose { at, heading_rad: path.heading_rad.unwrap_or(towards) }
}

/// Angle from a robot's heading to the direction of a point, rad.
fn error_rad(pose: &Pose, goal: Point) -> f64 {
    let (dx_m, dy_m) = (goal.x_m - pose.at.x_m, goal.y_m - pose.at.y_m);
    wrap(libm::atan2(dy_m, dx_m) - pose.heading_rad)
}

/// An angle within ±π.
fn wrap(angle_rad: f64) -> f64 {
    libm::atan2(libm::sin(angle_rad), libm::cos(angle_rad))
}
