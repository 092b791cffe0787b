//! Collision avoidance: the active-set method equals the full quadratic program and an independent
//! slow solver; robots never collide.

use joulebus_plant::arena::{HALF_ARENA_M, ROBOT_M};
use joulebus_plant::parts::Parts;
use joulebus_sim::barrier::{Answer, Barrier, BarrierError, Vector};
use joulebus_sim::scenario;
use proptest::prelude::*;

const TOLERANCE_MPS: f64 = 2e-5;

/// Robots at random positions, some close together, and their desired velocities.
fn group() -> impl Strategy<Value = (Vec<Vector>, Vec<Vector>)> {
    let place = |half_m: f64| -half_m + 0.1..half_m - 0.1;
    let robot = (place(HALF_ARENA_M.0), place(HALF_ARENA_M.1), -0.2..0.2, -0.2..0.2);
    (proptest::collection::vec(robot, 1..8), 0.2..1.0)
        .prop_map(|(robots, spread)| {
            let spread: f64 = spread;
            let point = |&(x, y, _, _): &(f64, f64, f64, f64)| Vector::new(x * spread, y * spread);
            let wanted = |&(_, _, x, y): &(f64, f64, f64, f64)| Vector::new(x, y);
            (robots.iter().map(point).collect(), robots.iter().map(wanted).collect())
        })
        .prop_filter("overlapping robots may have no allowed velocities", |(points, _)| {
            let points: &Vec<Vector> = points;
            (1..points.len())
                .all(|i| points[..i].iter().all(|other| (points[i] - other).norm() > 0.23))
        })
}

/// Hildreth's method: one multiplier at a time, until convergence.
fn projected(barrier: Barrier, points: &[Vector], wanted: &[Vector]) -> Vec<Vector> {
    let robots = points.len();
    let mut conditions: Vec<(Vec<f64>, f64)> = Vec::new();
    for i in 0..robots {
        for j in 0..i {
            let apart = [points[i][0] - points[j][0], points[i][1] - points[j][1]];
            let h = apart[0].powi(2) + apart[1].powi(2) - barrier.distance_m.powi(2);
            let mut slopes = vec![0.0; 2 * robots];
            for axis in 0..2 {
                slopes[2 * i + axis] = -2.0 * apart[axis];
                slopes[2 * j + axis] = 2.0 * apart[axis];
            }
            conditions.push((slopes, barrier.gain * h.powi(3)));
        }
        for (axis, half_m) in [HALF_ARENA_M.0, HALF_ARENA_M.1].into_iter().enumerate() {
            for side in [-1.0, 1.0] {
                let h = half_m - side * points[i][axis] - barrier.wall_m;
                let mut slopes = vec![0.0; 2 * robots];
                slopes[2 * i + axis] = side;
                conditions.push((slopes, barrier.wall_gain * h.powi(3)));
            }
        }
    }
    let mut velocities: Vec<f64> = wanted.iter().flatten().copied().collect();
    let mut multipliers = vec![0.0; conditions.len()];
    for _ in 0..100_000 {
        let mut moved = 0.0_f64;
        for ((slopes, bound), multiplier) in conditions.iter().zip(&mut multipliers) {
            let value: f64 = slopes.iter().zip(&velocities).map(|(a, u)| a * u).sum();
            let square: f64 = slopes.iter().map(|a| a * a).sum();
            let step = ((value - bound) / square).max(-*multiplier);
            *multiplier += step;
            for (velocity, slope) in velocities.iter_mut().zip(slopes) {
                *velocity -= step * slope;
                moved = moved.max((step * slope).abs());
            }
        }
        if moved < 1e-12 {
            break;
        }
    }
    velocities.chunks(2).map(Vector::from_column_slice).collect()
}

fn furthest(a: &[Vector], b: &[Vector]) -> f64 {
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

proptest! {
    #[test]
    fn skipped_conditions_do_not_change_the_solution((points, wanted) in group()) {
        let barrier = Barrier::default();
        let quick = barrier.allowed(&points, &wanted).expect("a solution exists");
        let whole = barrier.allowed_by_whole_program(&points, &wanted).expect("a solution exists");
        let off_mps = furthest(&quick.velocities, &whole);
        prop_assert!(off_mps < TOLERANCE_MPS, "{quick:?} {whole:?}");
    }

    #[test]
    fn the_solution_equals_that_of_an_independent_slow_solver((points, wanted) in group()) {
        let barrier = Barrier::default();
        let quick = barrier.allowed(&points, &wanted).expect("a solution exists");
        let slow = projected(barrier, &points, &wanted);
        let off_mps = furthest(&quick.velocities, &slow);
        prop_assert!(off_mps < TOLERANCE_MPS, "{quick:?} {slow:?}");
        prop_assert_eq!(quick.answer == Answer::AsWanted, wanted == slow);
    }
}

#[test]
fn the_numbers_of_positions_and_velocities_must_be_equal() {
    let refused = Barrier::default().allowed(&[Vector::zeros(); 2], &[Vector::zeros()]);
    let expected = BarrierError::Lengths { points: 2, wanted: 1 };
    assert_eq!(refused, Err(expected));
}

#[test]
fn seven_robots_meet_and_never_touch_or_leave_the_arena() {
    for seed in 1..4 {
        let run = scenario::run(Parts::default(), seed, 6_000);
        println!(
            "seed {seed}: closest {:.3} m, {} of 6,000 steps changed, {} solved, {} stops",
            run.closest_m, run.changed_steps, run.solved_steps, run.stopped_steps
        );
        assert!(run.closest_m > ROBOT_M, "{}", run.closest_m);
        assert!(run.closest_m < 0.35, "they never met: {}", run.closest_m);
        assert!(run.solved_steps > 300, "{}", run.solved_steps);
        assert_eq!(run.stopped_steps, 0);
        for trial in &run.trials {
            use joulebus_dataset::trial::Column;
            for (column, half_m) in [(Column::X, HALF_ARENA_M.0), (Column::Y, HALF_ARENA_M.1)] {
                let places_m = trial.column(column).expect("poses are recorded");
                let inside = |at_m: &f64| at_m.abs() <= half_m - ROBOT_M / 2.0;
                assert!(places_m.iter().all(inside), "robot {:?}", trial.robot_name());
            }
        }
    }
}
