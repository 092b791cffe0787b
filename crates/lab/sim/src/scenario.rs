//! Seven robots on a random walk, separated by control barrier functions.
//!
//! Each robot is to move its projected point, a little ahead of its wheels, at a random speed in a
//! random direction, both redrawn every few seconds. [`super::barrier`] modifies velocities that
//! would lead to a collision or out of the arena. The result is converted to v and ω, and the
//! wheels saturate. The seven share a radio channel, so each has more bursts than a robot alone.
//! Four of the paper's seven (1, 2, 3 and 6) drew more than the rest: `EXTRA_W` sets that without a
//! physical cause.

use std::path::PathBuf;

use super::barrier::{Answer, Barrier, Vector};
use super::protocol::MADE;
use super::recorder::Recorder;
use joulebus_dataset::trial::Trial;
use joulebus_plant::arena::{self, Command, HALF_ARENA_M, Pose, STEP_S, V_MAX_MPS, saturated};
use joulebus_plant::body::Body;
use joulebus_plant::parts::Parts;
use joulebus_statistics::noise::Noise;
use std::f64::consts::PI;

/// Robots of the scenario.
pub const ROBOTS: usize = 7;
/// Additional load of robots 1 to 7 over the robot of the trials, W.
const EXTRA_W: [f64; ROBOTS] = [0.6, 0.8, 0.5, 0.0, 0.0, 0.4, 0.0];
/// Distance from a robot's centre to its projected point, m.
const PROJECTION_M: f64 = 0.05;

/// Random streams: a robot's state, its walk, the initial poses.
const STATE: u64 = 4 << 32;
const WALK: u64 = 5 << 32;
const PLACES: u64 = 6 << 32;

/// Result of a run of the scenario.
#[derive(Debug)]
pub struct Run {
    /// One trial per robot, sorted by id. Ids start at 1.
    pub trials: Vec<Trial>,
    /// Minimum distance between the centres of two robots at the end of any step, m.
    pub closest_m: f64,
    /// Steps in which a desired motion violated a barrier.
    pub changed_steps: usize,
    /// Steps in which a quadratic program was solved.
    pub solved_steps: usize,
    /// Steps in which no solution was found and all robots stopped.
    pub stopped_steps: usize,
}

/// The file name of a robot's trial without extension. Ids start at 1.
pub fn file_stem(robot: u32) -> String {
    format!("energy_data_seven_robots_robot{robot}")
}

/// Runs the seven robots of `seed` for `steps` steps of 33 ms, at least two.
pub fn seven_robots(seed: u64, steps: usize) -> Vec<Trial> {
    run(Parts::default(), seed, steps).trials
}

/// Same as [`seven_robots`], with given parameters, and with statistics of the barriers.
pub fn run(parts: Parts, seed: u64, steps: usize) -> Run {
    let mut fleet = SimulatedFleet::new(parts, seed);
    let mut recorders: Vec<Recorder> =
        (0..ROBOTS).map(|_| Recorder::with_capacity(steps)).collect();
    for step in 0..steps.max(2) {
        let commands = fleet.commands();
        for ((body, recorder), (phase, command)) in
            fleet.bodies.iter_mut().zip(&mut recorders).zip(commands)
        {
            recorder.step(body, step, phase, command);
        }
        fleet.closest_m = fleet.closest_m.min(fleet.distance_m());
    }
    let trials = recorders.into_iter().zip(1u32..).map(|(recorder, robot)| {
        let path = PathBuf::from(format!("simulated/{}.npy", file_stem(robot)));
        recorder.finish(&path, robot)
    });
    Run {
        trials: trials.collect(),
        closest_m: fleet.closest_m,
        changed_steps: fleet.changed_steps,
        solved_steps: fleet.solved_steps,
        stopped_steps: fleet.stopped_steps,
    }
}

struct SimulatedFleet {
    bodies: Vec<Body>,
    walks: Vec<Walk>,
    barrier: Barrier,
    closest_m: f64,
    changed_steps: usize,
    solved_steps: usize,
    stopped_steps: usize,
}

impl SimulatedFleet {
    fn new(parts: Parts, seed: u64) -> Self {
        let mut places = Noise::new(seed, PLACES);
        let mut pose = |robot: usize| {
            let (column, line) = (robot % 4, robot / 4);
            Pose {
                at_m: arena::Vector::new(
                    -1.2 + 0.8 * column as f64 + places.between(-0.1, 0.1),
                    -0.5 + line as f64 + places.between(-0.1, 0.1),
                ),
                theta_rad: places.between(-PI, PI),
            }
        };
        let body = |robot: usize| {
            let id = robot as u64 + 1;
            let mut made = Noise::new(seed, MADE + id);
            let state = Noise::new(seed, STATE + id);
            let extra_w = EXTRA_W[robot];
            Body::new(parts, extra_w, ROBOTS - 1, pose(robot), &mut made, state)
        };
        let bodies: Vec<Body> = (0..ROBOTS).map(body).collect();
        let walk = |robot: usize| Walk::new(Noise::new(seed, WALK + robot as u64));
        Self {
            bodies,
            walks: (0..ROBOTS).map(walk).collect(),
            barrier: Barrier::default(),
            closest_m: f64::INFINITY,
            changed_steps: 0,
            solved_steps: 0,
            stopped_steps: 0,
        }
    }

    /// Phase and command of each robot for the next step. Phase 1 marks a step in which the
    /// barriers changed the desired motion.
    fn commands(&mut self) -> Vec<(u32, Command)> {
        let points: Vec<Vector> = self.bodies.iter().map(|body| point(body.pose)).collect();
        let walks = self.walks.iter_mut().zip(&points);
        let wanted: Vec<Vector> = walks.map(|(walk, point)| walk.next(*point)).collect();
        let allowed = match self.barrier.allowed(&points, &wanted) {
            Ok(allowed) => {
                self.changed_steps += usize::from(allowed.answer != Answer::AsWanted);
                self.solved_steps += usize::from(allowed.answer == Answer::Solved);
                allowed.velocities
            }
            Err(_) => {
                self.stopped_steps += 1;
                vec![Vector::zeros(); ROBOTS]
            }
        };
        let robots = self.bodies.iter().zip(wanted).zip(allowed);
        robots
            .map(|((body, wanted), allowed)| {
                let phase = u32::from(wanted != allowed);
                (phase, saturated(command(body.pose, allowed)))
            })
            .collect()
    }

    fn distance_m(&self) -> f64 {
        let mut closest_m = f64::INFINITY;
        for (i, a) in self.bodies.iter().enumerate() {
            for b in &self.bodies[..i] {
                closest_m = closest_m.min((a.pose.at_m - b.pose.at_m).norm());
            }
        }
        closest_m
    }
}

/// The projected point of a robot.
fn point(pose: Pose) -> Vector {
    vector(pose.at_m) + direction(pose.theta_rad) * PROJECTION_M
}

fn direction(angle_rad: f64) -> Vector {
    vector(arena::direction(angle_rad))
}

/// Converts to the vectors of barriers.
fn vector(of: arena::Vector) -> Vector {
    Vector::new(of.x, of.y)
}

/// The command that moves the projected point at a velocity.
fn command(pose: Pose, velocity: Vector) -> Command {
    let ahead = direction(pose.theta_rad);
    Command { v_mps: ahead.dot(&velocity), omega_radps: ahead.perp(&velocity) / PROJECTION_M }
}

/// The desired motion of a robot.
struct Walk {
    noise: Noise,
    wanted: Vector,
    left_s: f64,
}

impl Walk {
    const MIN_S: f64 = 1.0;
    const MAX_S: f64 = 5.0;
    const REST_SHARE: f64 = 0.15;
    const MARGIN_M: f64 = 0.25;

    fn new(noise: Noise) -> Self {
        Self { noise, wanted: Vector::zeros(), left_s: 0.0 }
    }

    fn next(&mut self, point: Vector) -> Vector {
        if self.left_s <= 0.0 {
            self.draw(point);
        }
        self.left_s -= STEP_S;
        self.wanted
    }

    fn draw(&mut self, point: Vector) {
        let noise = &mut self.noise;
        self.left_s = noise.between(Self::MIN_S, Self::MAX_S);
        let rests = noise.uniform() < Self::REST_SHARE;
        let ahead = direction(noise.between(-PI, PI));
        let speed_mps = noise.between(0.05, V_MAX_MPS);
        self.wanted = if rests { Vector::zeros() } else { ahead * speed_mps };
        // Near a wall the desired velocity points to the centre.
        for (wanted_mps, (at_m, half_m)) in
            self.wanted.iter_mut().zip(point.iter().zip([HALF_ARENA_M.0, HALF_ARENA_M.1]))
        {
            if at_m.abs() > half_m - Self::MARGIN_M && at_m * *wanted_mps > 0.0 {
                *wanted_mps = -*wanted_mps;
            }
        }
    }
}
