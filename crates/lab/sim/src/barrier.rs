//! Collision avoidance: control barrier functions on single integrators.
//!
//! Every robot is a point with a commanded velocity. The barrier of a pair is `h = |pᵢ − pⱼ|² −
//! D²`, that of a wall the distance to it; velocities are allowed if `dh/dt + g·h³ ≥ 0` holds for
//! all barriers (Wang, Ames and Egerstedt, "Safety barrier certificates for collisions-free
//! multirobot systems", IEEE T-RO 2017, with the cubic form used on the Robotarium). The allowed
//! velocities closest to the desired ones are the solution of a quadratic program.
//!
//! If the desired velocities violate no condition they are the solution, and no program is solved.
//! Wall conditions act on single components, so clamping solves them exactly, and if the clamped
//! velocities satisfy the pair conditions too they are the solution. Otherwise an active-set method
//! solves a program with the violated conditions only and adds those that its solution violates
//! until none is: a solution of a relaxed program that is feasible for the full one solves the full
//! one. Robots in no active condition keep their desired velocities.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver as _, NonnegativeConeT, SolverStatus,
};

use joulebus_plant::arena::HALF_ARENA_M;

/// A position in m, or a velocity in m/s: (x, y).
pub type Vector = nalgebra::Vector2<f64>;

/// Allowed violation of a condition, m/s or m²/s: the solver's accuracy.
const TOLERANCE: f64 = 1e-7;

/// Barrier parameters of a group of robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Barrier {
    /// Minimum distance of two points, m.
    pub distance_m: f64,
    /// Minimum distance of a point from a wall, m.
    pub wall_m: f64,
    /// Gain of a pair's barrier, which limits the closing speed, 1/(m⁴ s).
    pub gain: f64,
    /// Gain of a wall's barrier, which limits the approach speed, 1/(m² s).
    pub wall_gain: f64,
}

impl Default for Barrier {
    /// The distance of two robots of 0.11 m whose points lie 0.05 m ahead of them, and the
    /// Robotarium's gain.
    fn default() -> Self {
        Self { distance_m: 0.23, wall_m: 0.11, gain: 100.0, wall_gain: 40.0 }
    }
}

/// Allowed velocities.
#[derive(Clone, Debug, PartialEq)]
pub struct Allowed {
    /// The velocity of each robot.
    pub velocities: Vec<Vector>,
    /// Method that found them.
    pub answer: Answer,
}

/// Method that found the allowed velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// All desired velocities are allowed.
    AsWanted,
    /// Only wall conditions were violated. Components were clamped.
    Walls,
    /// A quadratic program was solved.
    Solved,
}

/// Errors of computing allowed velocities.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum BarrierError {
    #[error("{points} positions and {wanted} velocities. Give one of each for every robot")]
    Lengths { points: usize, wanted: usize },
    #[error("no allowed velocities for {robots} robots and {barriers} barriers: {status}")]
    Unsolved { robots: usize, barriers: usize, status: String },
}

/// One condition: `Σ slope·velocity ≤ bound` over one or two robots.
#[derive(Clone, Copy, Debug)]
struct Condition {
    robots: [usize; 2],
    slopes: [Vector; 2],
    bound: f64,
}

impl Condition {
    /// Violation of the condition. At most 0 if it holds.
    fn excess(&self, velocities: &[Vector]) -> f64 {
        let [a, b] = self.robots;
        self.slopes[0].dot(&velocities[a]) + self.slopes[1].dot(&velocities[b]) - self.bound
    }
}

impl Barrier {
    /// The allowed velocities closest to the desired ones.
    ///
    /// # Errors
    /// [`BarrierError`]: the numbers of positions and velocities differ, or no velocities are
    /// allowed, as may happen when robots are already too close on several sides.
    pub fn allowed(&self, points: &[Vector], wanted: &[Vector]) -> Result<Allowed, BarrierError> {
        let conditions = self.conditions(points, wanted)?;
        let mut active = Vec::new();
        if !add_violated(&conditions, wanted, 0.0, &mut active) {
            return Ok(Allowed { velocities: wanted.to_vec(), answer: Answer::AsWanted });
        }
        let mut velocities = within_walls(&conditions, wanted);
        let mut still = Vec::new();
        let answer = if add_violated(&conditions, &velocities, TOLERANCE, &mut still) {
            still.retain(|number| !active.contains(number));
            active.append(&mut still);
            velocities = nearest(&conditions, &active, wanted)?;
            // Each iteration adds a condition, which bounds their number.
            while add_violated(&conditions, &velocities, TOLERANCE, &mut active) {
                velocities = nearest(&conditions, &active, wanted)?;
            }
            Answer::Solved
        } else {
            Answer::Walls
        };
        Ok(Allowed { velocities, answer })
    }

    /// Same as [`Barrier::allowed`], with all conditions and all robots in one program: the slow
    /// reference.
    ///
    /// # Errors
    /// Same as [`Barrier::allowed`].
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
            return Err(BarrierError::Lengths { points: points.len(), wanted: wanted.len() });
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
        Condition { robots, slopes: [apart * -2.0, apart * 2.0], bound: self.gain * h * h * h }
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

/// Adds the conditions that the velocities violate by more than `tolerance` and that are not active
/// yet. Returns whether there were any.
fn add_violated(
    conditions: &[Condition],
    velocities: &[Vector],
    tolerance: f64,
    active: &mut Vec<usize>,
) -> bool {
    let before = active.len();
    for (number, condition) in conditions.iter().enumerate() {
        // Not `>`: NaN counts as a violation.
        let holds = condition.excess(velocities) <= tolerance;
        if !holds && !active[..before].contains(&number) {
            active.push(number);
        }
    }
    active.len() > before
}

/// The velocities closest to the desired ones that satisfy the wall conditions.
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

/// The velocities closest to the desired ones that satisfy the active conditions.
fn nearest(
    conditions: &[Condition],
    active: &[usize],
    wanted: &[Vector],
) -> Result<Vec<Vector>, BarrierError> {
    let mut robots: Vec<usize> =
        active.iter().flat_map(|number| conditions[*number].robots).collect();
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
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
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
