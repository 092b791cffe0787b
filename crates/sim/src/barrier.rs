//! Collision avoidance: control barrier functions on single integrators.
//!
//! Every robot is a point that moves at the velocity it is given. The barrier of a pair is
//! `h = |pᵢ − pⱼ|² − D²`, that of a wall the distance to it; a set of velocities is allowed where
//! `dh/dt + g·h³ ≥ 0` holds for all of them (Wang, Ames and Egerstedt, "Safety barrier
//! certificates for collisions-free multirobot systems", IEEE T-RO 2017, with the cubic form used on
//! the Robotarium). Of the allowed velocities those nearest to the wanted ones are taken: a
//! quadratic program.
//!
//! Where the wanted velocities violate nothing they are that program's answer, so nothing is solved.
//! Walls alone cut each component by itself: that program's answer needs no solver either, and where
//! it is allowed by the pairs too it is the answer of the whole. Otherwise only the violated barriers
//! are put to the solver, and those that its answer violates are added until there is none: the
//! answer to a relaxed program that is allowed in the whole one is the whole one's answer. Robots
//! that no such barrier names keep what they want.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver as _, NonnegativeConeT, SolverStatus,
};

use super::arena::{HALF_ARENA_M, Vector};

/// An answer may miss a barrier's condition by this much, m/s or m²/s: the solver's accuracy.
const TOLERANCE: f64 = 1e-7;

/// The barriers of a group of robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Barrier {
    /// Distance that two points keep, m.
    pub distance_m: f64,
    /// Distance that a point keeps from a wall, m.
    pub wall_m: f64,
    /// How fast a pair may close in, 1/(m⁴ s).
    pub gain: f64,
    /// How fast a point may near a wall, 1/(m² s).
    pub wall_gain: f64,
}

impl Default for Barrier {
    /// The distance covers two robots of 0.11 m whose points lie 0.05 m ahead of them; the gain is
    /// the Robotarium's.
    fn default() -> Self {
        Self {
            distance_m: 0.23,
            wall_m: 0.11,
            gain: 100.0,
            wall_gain: 40.0,
        }
    }
}

/// Allowed velocities.
#[derive(Clone, Debug, PartialEq)]
pub struct Allowed {
    /// One a robot.
    pub velocities: Vec<Vector>,
    /// How they were found.
    pub answer: Answer,
}

/// How allowed velocities were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// All wanted ones are allowed.
    AsWanted,
    /// Only walls were in the way; each component was cut by itself.
    Walls,
    /// A quadratic program was solved.
    Solved,
}

/// Why there are no allowed velocities.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BarrierError {
    /// Positions and velocities are not of the same robots.
    #[error("{points} positions and {wanted} velocities; give one of each for every robot")]
    Lengths {
        /// Positions given.
        points: usize,
        /// Velocities given.
        wanted: usize,
    },
    /// The solver found none.
    #[error("no allowed velocities for {robots} robots and {barriers} barriers: {status}")]
    Unsolved {
        /// Robots in the program.
        robots: usize,
        /// Barriers in the program.
        barriers: usize,
        /// What the solver says.
        status: String,
    },
}

/// One condition: `Σ slope·velocity ≤ bound` over one robot or two.
#[derive(Clone, Copy, Debug)]
struct Condition {
    robots: [usize; 2],
    slopes: [Vector; 2],
    bound: f64,
}

impl Condition {
    /// By how much velocities violate it; at most 0 where they do not.
    fn excess(&self, velocities: &[Vector]) -> f64 {
        let [a, b] = self.robots;
        self.slopes[0].dot(&velocities[a]) + self.slopes[1].dot(&velocities[b]) - self.bound
    }
}

impl Barrier {
    /// The allowed velocities nearest to the wanted ones.
    ///
    /// # Errors
    /// [`BarrierError`]: as many positions as velocities are needed; robots that are already too
    /// close on several sides may have no way out.
    pub fn allowed(&self, points: &[Vector], wanted: &[Vector]) -> Result<Allowed, BarrierError> {
        let conditions = self.conditions(points, wanted)?;
        let mut active = Vec::new();
        if !add_violated(&conditions, wanted, 0.0, &mut active) {
            return Ok(Allowed {
                velocities: wanted.to_vec(),
                answer: Answer::AsWanted,
            });
        }
        let mut velocities = within_walls(&conditions, wanted);
        let mut still = Vec::new();
        let answer = if add_violated(&conditions, &velocities, TOLERANCE, &mut still) {
            still.retain(|number| !active.contains(number));
            active.append(&mut still);
            velocities = nearest(&conditions, &active, wanted)?;
            // Each turn adds a condition, so there are at most as many as conditions.
            while add_violated(&conditions, &velocities, TOLERANCE, &mut active) {
                velocities = nearest(&conditions, &active, wanted)?;
            }
            Answer::Solved
        } else {
            Answer::Walls
        };
        Ok(Allowed { velocities, answer })
    }

    /// As [`Barrier::allowed`], all conditions and all robots in one program: the slow way, to hold
    /// the quick one against.
    ///
    /// # Errors
    /// As [`Barrier::allowed`].
    pub fn allowed_by_whole_program(
        &self,
        points: &[Vector],
        wanted: &[Vector],
    ) -> Result<Vec<Vector>, BarrierError> {
        let conditions = self.conditions(points, wanted)?;
        let all: Vec<usize> = (0..conditions.len()).collect();
        nearest(&conditions, &all, wanted)
    }

    fn conditions(
        &self,
        points: &[Vector],
        wanted: &[Vector],
    ) -> Result<Vec<Condition>, BarrierError> {
        if points.len() != wanted.len() {
            return Err(BarrierError::Lengths {
                points: points.len(),
                wanted: wanted.len(),
            });
        }
        let mut conditions = Vec::with_capacity(points.len() * (points.len() + 7) / 2);
        for (robot, point) in points.iter().enumerate() {
            for (other, other_point) in points[..robot].iter().enumerate() {
                conditions.push(self.pair([robot, other], [*point, *other_point]));
            }
            for (axis, half_m) in [HALF_ARENA_M.0, HALF_ARENA_M.1].into_iter().enumerate() {
                for side in [-1.0, 1.0] {
                    conditions.push(self.wall(robot, axis, side, half_m - side * point[axis]));
                }
            }
        }
        Ok(conditions)
    }

    fn pair(&self, robots: [usize; 2], [a, b]: [Vector; 2]) -> Condition {
        let apart = a - b;
        let h = apart.norm_squared() - self.distance_m * self.distance_m;
        Condition {
            robots,
            slopes: [apart * -2.0, apart * 2.0],
            bound: self.gain * h * h * h,
        }
    }

    fn wall(&self, robot: usize, axis: usize, side: f64, away_m: f64) -> Condition {
        let h = away_m - self.wall_m;
        let mut slope = Vector::zeros();
        slope[axis] = side;
        Condition {
            robots: [robot, robot],
            slopes: [slope, Vector::zeros()],
            bound: self.wall_gain * h * h * h,
        }
    }
}

/// Adds the conditions that velocities violate by more than `tolerance` and that are not in yet;
/// whether there were any.
fn add_violated(
    conditions: &[Condition],
    velocities: &[Vector],
    tolerance: f64,
    active: &mut Vec<usize>,
) -> bool {
    let before = active.len();
    for (number, condition) in conditions.iter().enumerate() {
        // Not `>`: what is NaN counts as violated.
        let holds = condition.excess(velocities) <= tolerance;
        if !holds && !active[..before].contains(&number) {
            active.push(number);
        }
    }
    active.len() > before
}

/// The velocities nearest to the wanted ones for which the conditions of walls hold.
fn within_walls(conditions: &[Condition], wanted: &[Vector]) -> Vec<Vector> {
    let mut velocities = wanted.to_vec();
    for condition in conditions {
        let [robot, other] = condition.robots;
        let holds = condition.excess(&velocities) <= 0.0;
        if robot == other && !holds {
            // The slope of a wall is ±1 along its axis.
            for (speed_mps, slope) in velocities[robot].iter_mut().zip(&condition.slopes[0]) {
                if *slope != 0.0 {
                    *speed_mps = slope * condition.bound;
                }
            }
        }
    }
    velocities
}

/// The velocities nearest to the wanted ones for which the active conditions hold.
fn nearest(
    conditions: &[Condition],
    active: &[usize],
    wanted: &[Vector],
) -> Result<Vec<Vector>, BarrierError> {
    let mut robots: Vec<usize> = active
        .iter()
        .flat_map(|number| conditions[*number].robots)
        .collect();
    robots.sort_unstable();
    robots.dedup();
    let place = |robot: usize| robots.partition_point(|other| *other < robot);

    let variables = 2 * robots.len();
    let (mut row, mut column, mut value) = (Vec::new(), Vec::new(), Vec::new());
    let mut bounds = Vec::with_capacity(active.len());
    for (line, number) in active.iter().enumerate() {
        let condition = &conditions[*number];
        bounds.push(condition.bound);
        for (robot, slope) in condition.robots.into_iter().zip(condition.slopes) {
            for (axis, slope) in slope.iter().enumerate() {
                if *slope != 0.0 {
                    row.push(line);
                    column.push(2 * place(robot) + axis);
                    value.push(*slope);
                }
            }
        }
    }
    let slopes = CscMatrix::new_from_triplets(active.len(), variables, row, column, value);
    let linear: Vec<f64> = robots
        .iter()
        .flat_map(|robot| wanted[*robot].data.0[0].map(|speed_mps| -speed_mps))
        .collect();
    let unsolved = |status: String| BarrierError::Unsolved {
        robots: robots.len(),
        barriers: active.len(),
        status,
    };
    let settings = DefaultSettings {
        verbose: false,
        ..DefaultSettings::default()
    };
    let mut solver = DefaultSolver::new(
        &CscMatrix::identity(variables),
        &linear,
        &slopes,
        &bounds,
        &[NonnegativeConeT(active.len())],
        settings,
    )
    .map_err(|error| unsolved(error.to_string()))?;
    solver.solve();
    if solver.solution.status != SolverStatus::Solved {
        return Err(unsolved(solver.solution.status.to_string()));
    }
    let mut velocities = wanted.to_vec();
    for (robot, speeds) in robots.iter().zip(solver.solution.x.chunks_exact(2)) {
        velocities[*robot] = Vector::from_column_slice(speeds);
    }
    Ok(velocities)
}
