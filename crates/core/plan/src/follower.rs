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
//! stop, at most as fast as it can turn there. The stairs of a grid are straight lines
//! ([`Path::simplified`]). It turns while it drives, and drives backwards if the
//! point is behind it. The path ends within 5 cm of its last point.
//!
//! A leg ends when the robot is within 5 cm of its point, or has passed it, and has waited there. The
//! gains are those of the Robotarium simulator's position controllers.
//!
//! A path with times states where the robot is when. With x(t) that distance along the path at the
//! end of the step, and x the robot's own, its speed is dx/dt + 0.8/s · (x(t) − x), from 0 to the
//! platform's. It does not slow down before it arrives: the times say how fast it is. A robot that
//! arrives early waits.

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
/// Delay at a point of a path with times that is not stated, s.
const IN_TIME_S: f64 = 1.0;

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
    /// Power that each leg adds, W. Empty if none does.
    pub load_w: Vec<f32>,
    /// Steps of the wait at the first point, and the power that it adds, W.
    pub(crate) start: (usize, f32),
    /// Pose before each step, and after the last.
    pub poses: Vec<Pose>,
    /// The longest delay at a point of a path with times, s. 0 if it is at most a second.
    pub late_s: f32,
}

/// Distances along a path at times, from the path's beginning, m and s. Both never fall.
#[derive(Debug)]
struct Timetable {
    along_m: Vec<f64>,
    time_s: Vec<f64>,
    /// Distance along the path of each vertex.
    vertices_m: Vec<f64>,
    /// The interval in which the last time was.
    at: usize,
}

impl Timetable {
    /// `None` for a path without times.
    fn new(path: &Path, shape: &Shape<'_>) -> Option<Self> {
        let begin_s = path.time_s.first()?;
        let (mut along_m, mut vertices_m) = (vec![0.0; path.points.len()], vec![0.0]);
        let mut point = 0;
        for vertex in 1..shape.count() {
            let begin_m = vertices_m[vertex - 1];
            let (_, edge_m) = shape.beside(shape.at(vertex), vertex);
            while point < shape.index(vertex) {
                let share = shape.beside(path.points[point], vertex).0;
                let before_m = point.checked_sub(1).map_or(0.0, |before| along_m[before]);
                along_m[point] = (begin_m + share * edge_m).max(before_m);
                point += 1;
            }
            vertices_m.push(begin_m + edge_m);
        }
        let end_m = vertices_m[shape.count() - 1];
        along_m[point..].fill(end_m);
        let time_s = path.time_s.iter().map(|time_s| time_s - begin_s).collect();
        Some(Self { along_m, time_s, vertices_m, at: 0 })
    }

    fn end_s(&self) -> f64 {
        self.time_s.last().copied().unwrap_or(0.0)
    }

    /// The speed at a time at which a robot that is `along_m` from the beginning keeps its times,
    /// m/s. Times that are asked for never fall.
    fn speed_mps(&mut self, time_s: f64, along_m: f64) -> f64 {
        while self.at + 2 < self.time_s.len() && self.time_s[self.at + 1] <= time_s {
            self.at += 1;
        }
        let next = (self.at + 1).min(self.time_s.len() - 1);
        let [begin, end] = [self.at, next].map(|point| (self.time_s[point], self.along_m[point]));
        let planned_mps = if end.0 > begin.0 { (end.1 - begin.1) / (end.0 - begin.0) } else { 0.0 };
        let is_over = time_s >= end.0;
        let planned_m = if is_over { end.1 } else { begin.1 + planned_mps * (time_s - begin.0) };
        let planned_mps = if is_over { 0.0 } else { planned_mps };
        (planned_mps + GAIN * (planned_m - along_m)).max(0.0)
    }
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
        let mut timetable = Timetable::new(path, &shape);
        let mut followed = Followed {
            period_s: self.period_s as f32,
            v_mps: Vec::new(),
            omega_radps: Vec::new(),
            leg_ends: Vec::with_capacity(path.legs()),
            load_w: path.load_w.iter().skip(1).map(|load_w| *load_w as f32).collect(),
            start: (0, path.load_w.first().map_or(0.0, |load_w| *load_w as f32)),
            poses: vec![start(path, &shape)],
            late_s: 0.0,
        };
        self.wait(&mut followed, 0, shape.dwell_s(0))?;
        followed.start.0 = followed.v_mps.len();
        // The vertex beyond which the robot has looked.
        let mut seen = 0;
        for vertex in 1..shape.count() {
            seen = self.drive(&mut followed, path, (&shape, vertex), timetable.as_mut(), seen)?;
        }
        let steps = followed.v_mps.len();
        if let Some(timetable) = &timetable {
            followed.late_s = self.late_s(&followed, timetable);
            let early_s = timetable.end_s() - (steps + 1) as f64 * self.period_s;
            self.wait(&mut followed, path.legs(), early_s)?;
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

    /// Waits at a point.
    fn wait(&self, to: &mut Followed, point: usize, time_s: f64) -> Result<(), PathError> {
        let steps = (time_s / self.period_s).round().max(0.0) as usize;
        if steps > self.max_steps.saturating_sub(to.v_mps.len()) {
            let allowed_s = self.max_steps as f64 * self.period_s;
            return Err(PathError::Waits { point, found_s: time_s, allowed_s: allowed_s.round() });
        }
        let pose = to.poses[to.v_mps.len()];
        (0..steps).for_each(|_| self.push(to, pose, (0.0, 0.0)));
        Ok(())
    }

    /// The longest delay at a point, s.
    fn late_s(&self, followed: &Followed, timetable: &Timetable) -> f32 {
        let times = followed.leg_ends.iter().zip(&timetable.time_s[1..]);
        let delays = times.map(|(end, time_s)| *end as f64 * self.period_s - time_s);
        let late_s = delays.fold(0.0, f64::max);
        if late_s > IN_TIME_S { late_s as f32 } else { 0.0 }
    }

    /// Drives until a vertex is reached, or passed on the way to one that is `seen` beyond it, and
    /// waits there. Returns the last vertex that the robot has seen.
    fn drive(
        &self,
        to: &mut Followed,
        path: &Path,
        (shape, vertex): (&Shape<'_>, usize),
        mut timetable: Option<&mut Timetable>,
        mut seen: usize,
    ) -> Result<usize, PathError> {
        let (at, stated_mps) = (shape.at(vertex), shape.speed_mps(vertex));
        // Times ask for a speed, even if the path states none.
        let most_mps = if timetable.is_some() { f64::MAX } else { f64::INFINITY };
        let asked_mps = self.speed_mps(stated_mps.min(most_mps));
        let begun = to.v_mps.len();
        let first_m = distance_m(to.poses[begun].at, at);
        let turn_s = PI / f64::from(self.omega_max_radps).min(TURN_GAIN);
        let planned_s = timetable.as_ref().map_or(0.0, |of| of.end_s());
        let patience_s = PATIENCE * (first_m / asked_mps + turn_s + 10.0 / GAIN) + planned_s;
        let most = (patience_s / self.period_s) as usize;
        loop {
            let steps = to.v_mps.len();
            let pose = to.poses[steps];
            let is_reached = distance_m(pose.at, at) <= REACH_M
                || (seen > vertex && shape.is_behind(pose.at, vertex));
            // Legs end in their order: those up to the vertex with it, at the latest.
            while let point = to.leg_ends.len() + 1
                && point < shape.index(vertex)
                && (is_reached
                    || distance_m(pose.at, path.points[point]) <= REACH_M
                    || shape.is_abeam(pose.at, point, vertex))
            {
                to.leg_ends.push(steps);
            }
            let point = to.leg_ends.len() + 1;
            if is_reached {
                self.wait(to, point, shape.dwell_s(vertex))?;
                to.leg_ends.resize(shape.index(vertex), to.v_mps.len());
                return Ok(seen);
            }
            let distance_m = distance_m(pose.at, path.points[point]);
            if steps >= self.max_steps {
                return Err(PathError::TooLong { point, distance_m, allowed: self.max_steps });
            }
            if steps - begun >= most {
                return Err(PathError::NotReached { point, distance_m, steps: steps - begun });
            }
            let ahead = shape.ahead(pose.at, vertex, asked_mps / GAIN);
            seen = ahead.vertex;
            let limit_mps = if seen > vertex {
                asked_mps.min(self.turning_mps(&pose, &ahead))
            } else {
                asked_mps
            };
            let command = match timetable.as_deref_mut() {
                None => self.command(&pose, ahead.goal, limit_mps),
                Some(timetable) => {
                    let (share, edge_m) = shape.beside(pose.at, vertex);
                    let along_m = timetable.vertices_m[vertex - 1] + share * edge_m;
                    let next_s = (steps + 1) as f64 * self.period_s;
                    let planned_mps = timetable.speed_mps(next_s, along_m);
                    self.steer(&pose, ahead.goal, planned_mps.min(limit_mps))
                }
            };
            self.push(to, pose, command);
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
        self.steer(pose, goal, self.speed_mps(speed_mps).min(GAIN * distance_m(pose.at, goal)))
    }

    /// The command with which a robot drives towards a point at a speed, m/s, but not past it.
    fn steer(&self, pose: &Pose, goal: Point, along_mps: f64) -> (f32, f32) {
        let error_rad = error_rad(pose, goal);
        let along_mps = along_mps.min(distance_m(pose.at, goal) / self.period_s);
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
    let (at, second) = (path.points[0], shape.faced());
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
