//! The mission: floor, robots, batteries, chargers, tasks.

use joulebus_plan::Point;
use joulebus_plant::Fault;
use joulebus_plant::arena::{HALF_ARENA_M, Pose, Vector};
use joulebus_plant::driven::Driven;
use joulebus_plant::parts::Parts;
use joulebus_statistics::noise::Noise;
use serde::Serialize;

/// Speed at which tasks are driven, m/s: within the training data of the shipped model.
pub const SPEED_MPS: f64 = 0.15;
/// Greatest angular velocity commanded, rad/s: with it no wheel saturates.
pub(crate) const OMEGA_MAX_RADPS: f64 = 2.0;
/// Interval at which robots are switched on, s, so that they do not all run empty at once.
pub(crate) const SWITCHED_ON_EVERY_S: f64 = 10.0;
/// Distance of points from the walls, m.
const MARGIN_M: f64 = 0.15;
/// Points of a task, at least and at most.
const POINTS: (usize, usize) = (2, 5);
/// Additional load of the paper's seven robots compared with its trials, W (`sim::scenario`).
const EXTRA_W: [f64; 7] = [0.6, 0.8, 0.5, 0.0, 0.0, 0.4, 0.0];
/// Relative standard deviation of the friction of wheels.
const FRICTION_SPREAD: f64 = 0.3;
/// Relative standard deviation of a battery's true capacity and of a monitor's gain. Together they
/// are `counting_sd`.
const CAPACITY_SD: f64 = 0.02;
const GAIN_SD: f64 = 0.02;
/// Both are clamped to this many deviations.
const WIDEST: f64 = 2.5;

const TASKS: u64 = 20 << 32;
const MADE: u64 = 21 << 32;
const ROBOTS: u64 = 22 << 32;

/// The conditions that are equal for all policies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scenario {
    /// Robots.
    pub robots: usize,
    /// Number of chargers. Each takes one robot.
    pub chargers: usize,
    /// Simulated time, s.
    pub duration_s: f64,
    /// Nominal capacity of each battery, J.
    pub capacity_j: f64,
    /// Power that a charger stores, W. It supplies the robot's own load in addition.
    pub charge_w: f64,
    /// Time on a charger before it stores energy, s: the robot aligns itself with the contacts.
    pub docking_s: f64,
    /// Mean time between two tasks, s.
    pub task_every_s: f64,
    /// Share of robots in which a brush begins to drag at a random time.
    pub dragging_share: f64,
    /// Additional load of a dragging brush, W: at least, at most.
    pub dragging_w: (f64, f64),
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            robots: 20,
            chargers: 3,
            duration_s: 3600.0,
            capacity_j: 0.15 * 3600.0,
            charge_w: 60.0,
            docking_s: 5.0,
            task_every_s: 1.8,
            dragging_share: 0.1,
            dragging_w: (1.0, 3.0),
        }
    }
}

/// A task: points to be visited in order.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Task {
    pub at_s: f64,
    pub points: Vec<Point>,
}

/// A robot as it is made, which no policy knows.
#[derive(Clone, Debug)]
pub(crate) struct Made {
    pub driven: Driven,
    /// True capacity, J.
    pub capacity_j: f64,
    /// Factor of its monitor's readings.
    pub gain: f64,
}

impl Scenario {
    /// Position of a charger.
    pub(crate) fn charger(&self, charger: usize) -> Point {
        let y_m = (charger as f64 + 0.5) / self.chargers as f64 * 2.0 - 1.0;
        Point::new(-HALF_ARENA_M.0 + MARGIN_M, 0.8 * HALF_ARENA_M.1 * y_m)
    }

    /// Position of the line of waiting robots.
    pub(crate) fn line() -> Point {
        Point::new(-HALF_ARENA_M.0 + 3.0 * MARGIN_M, 0.0)
    }

    /// The path home in plans: to the line, and from there to the farthest charger.
    pub(crate) fn home(&self) -> [Point; 2] {
        [Self::line(), self.charger(0)]
    }

    /// The tasks of a seed, in the order of their arrival.
    pub(crate) fn tasks(&self, seed: u64) -> Vec<Task> {
        let mut noise = Noise::new(seed, TASKS);
        let (mut at_s, mut tasks) = (0.0, Vec::new());
        loop {
            at_s += noise.waiting_s(self.task_every_s);
            if at_s >= self.duration_s {
                return tasks;
            }
            let count = POINTS.0 + noise.below(POINTS.1 - POINTS.0 + 1);
            let points = (0..count).map(|_| anywhere(&mut noise)).collect();
            tasks.push(Task { at_s, points });
        }
    }

    /// Creates a robot from a seed, independent of the policy and of the number of robots.
    pub(crate) fn made(&self, seed: u64, robot: usize) -> Made {
        let mut noise = Noise::new(seed, MADE + robot as u64);
        let mut factor = |sd: f64| 1.0 + sd * noise.normal().clamp(-WIDEST, WIDEST);
        let (capacity_j, gain) = (self.capacity_j * factor(CAPACITY_SD), factor(GAIN_SD));
        let extra_w = EXTRA_W[noise.below(EXTRA_W.len())];
        let at = anywhere(&mut noise);
        let pose = Pose { at_m: Vector::new(at.x_m, at.y_m), theta_rad: 0.0 };
        let parts = Parts { friction_spread: FRICTION_SPREAD, ..Parts::default() };
        let stream = ROBOTS + 2 * robot as u64;
        let mut driven = Driven::new(parts, extra_w, pose, (seed, stream));
        let (drags, from_s) = (noise.uniform(), self.duration_s * noise.uniform());
        let power_w = noise.between(self.dragging_w.0, self.dragging_w.1);
        if drags < self.dragging_share {
            driven = driven.with_fault(Fault::ExtraLoad { power_w }, from_s);
        }
        Made { driven, capacity_j, gain }
    }
}

fn anywhere(noise: &mut Noise) -> Point {
    let (x_m, y_m) = (HALF_ARENA_M.0 - MARGIN_M, HALF_ARENA_M.1 - MARGIN_M);
    Point::new(noise.between(-x_m, x_m), noise.between(-y_m, y_m))
}
