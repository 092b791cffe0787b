//! The follower drives as the Robotarium simulator's controllers do, within the platform's limits.

use std::fs;
use std::path::{Path as FilePath, PathBuf};
use std::process::Command;

use joulebus_config::{Config, builtin_model};
use joulebus_energy::EnergyState;
use joulebus_plan::follow::{Follower, Pose};
use joulebus_plan::{Path, PathError, PlanFleet, Platform, Point};
use joulebus_predictor::{Model, Network, Persistence, ResidualStats};
use joulebus_testkit::counting;
use proptest::prelude::*;

fn fleet(v_max_mps: f32, omega_max_radps: f32) -> PlanFleet {
    let text =
        "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n";
    let config = Config::parse(text, FilePath::new("/nowhere")).expect("the config is valid");
    let mut settings = config.settings().clone();
    settings.platforms[0].v_max_mps = v_max_mps;
    settings.platforms[0].omega_max_radps = omega_max_radps;
    let residual = ResidualStats { std_w: 1.0, q05_w: -1.6, q95_w: 1.6 };
    let model = Model::Persistence(Persistence::new(residual).expect("finite"));
    PlanFleet::new(&settings, &[model])
}

fn follower(v_max_mps: f32, omega_max_radps: f32) -> Follower {
    let fleet = fleet(v_max_mps, omega_max_radps);
    Follower::new(&fleet.platforms()[0]).expect("it moves")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Whatever the path: all points are reached in order, every command is within the limits.
    #[test]
    fn every_point_is_reached_within_the_limits(
        corners in prop::collection::vec((-5.0f64..5.0, -5.0f64..5.0), 2..6),
        heading_rad in prop::option::of(-4.0f64..4.0),
        speed_mps in 0.02f64..3.0,
        v_max_mps in 0.05f32..2.0,
        omega_max_radps in 0.2f32..6.0,
    ) {
        let points: Vec<Point> = corners.iter().map(|(x, y)| Point::new(*x, *y)).collect();
        let path = Path { heading_rad, ..Path::new(&points, speed_mps) };
        let followed = follower(v_max_mps, omega_max_radps).follow(&path).expect("it gets there");
        prop_assert_eq!(followed.leg_ends.len(), points.len() - 1);
        prop_assert_eq!(followed.leg_ends.last(), Some(&followed.v_mps.len()));
        prop_assert_eq!(followed.poses.len(), followed.v_mps.len() + 1);
        prop_assert!(followed.leg_ends.is_sorted());
        for (leg, end) in followed.leg_ends.iter().enumerate() {
            let (at, goal) = (followed.poses[*end].at, points[leg + 1]);
            let away_m = (at.x_m - goal.x_m).hypot(at.y_m - goal.y_m);
            prop_assert!(away_m <= 0.05, "{} m from point {}", away_m, leg + 1);
        }
        for (v_mps, omega_radps) in followed.v_mps.iter().zip(&followed.omega_radps) {
            prop_assert!(v_mps.abs() <= v_max_mps && v_mps.abs() <= 1.000_001 * speed_mps as f32);
            prop_assert!(omega_radps.abs() <= omega_max_radps);
        }
    }
}

/// The platform that ships, with its limits for samples and its model.
fn shipped() -> Platform {
    let platform = fleet(0.25, 4.0).platforms()[0].settings.clone();
    let (_, bytes) = builtin_model("gternal-sim").expect("it ships");
    let network = Network::from_safetensors(bytes).expect("a valid file");
    let energy = network.card().energy.clone().expect("trained with one");
    Platform::new(platform, energy, network.hash())
}

/// The shipped platform with other limits of velocity.
fn limited(v_max_mps: f32, omega_max_radps: f32) -> Platform {
    let mut platform = shipped();
    (platform.settings.v_max_mps, platform.settings.omega_max_radps) = (v_max_mps, omega_max_radps);
    (platform.energy.v_mps, platform.energy.omega_radps) = ([-9.0, 9.0], [-9.0, 9.0]);
    platform
}

/// Energy, J, and time, s, of a path that a robot at rest follows.
fn cost(platform: &Platform, path: &Path) -> (f64, f64) {
    let follower = Follower::new(platform).expect("it moves");
    let followed = follower.follow(path).expect("it gets there");
    let forecast = platform.energy.forecast(&EnergyState::new(0), followed.commands());
    (forecast.energy_j.into(), forecast.duration_s.into())
}

/// The same way with more points: up to `spacing_m` apart, at the shares of a leg that `draw`
/// gives, 0 to 1, and with every third point repeated, the first and the last too.
fn described_anew(path: &Path, spacing_m: f64, mut draw: impl FnMut() -> f64) -> Path {
    let mut anew = Path { points: vec![path.points[0]; 2], speed_mps: Vec::new(), ..path.clone() };
    anew.speed_mps = vec![path.speed_mps[1]; 2];
    for (leg, speed_mps) in path.points.windows(2).zip(&path.speed_mps[1..]) {
        let (from, to) = (leg[0], leg[1]);
        let length_m = (to.x_m - from.x_m).hypot(to.y_m - from.y_m);
        let mut shares: Vec<f64> = (1..(length_m / spacing_m) as usize).map(|_| draw()).collect();
        shares.sort_by(f64::total_cmp);
        for share in shares {
            let point = Point::new(
                from.x_m + share * (to.x_m - from.x_m),
                from.y_m + share * (to.y_m - from.y_m),
            );
            let copies = if anew.points.len().is_multiple_of(3) { 2 } else { 1 };
            anew.points.extend(vec![point; copies]);
        }
        anew.points.extend([to; 2]);
        anew.speed_mps.resize(anew.points.len(), *speed_mps);
    }
    anew
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn points_inserted_on_a_path_or_repeated_change_neither_its_energy_nor_its_time(
        corners in prop::collection::vec((-3.0f64..3.0, -3.0f64..3.0), 2..6),
        speeds in prop::collection::vec(prop_oneof![0.02f64..2.0, Just(f64::INFINITY)], 6),
        heading_rad in prop::option::of(-4.0f64..4.0),
        v_max_mps in 0.05f32..2.0,
        omega_max_radps in 0.2f32..6.0,
        spacing_mm in 1u32..1_000,
        seed in any::<u64>(),
    ) {
        let points: Vec<Point> = corners.iter().map(|(x, y)| Point::new(*x, *y)).collect();
        let speed_mps = speeds[..points.len()].to_vec();
        let path = Path { points, speed_mps, heading_rad, ..Path::default() };
        let mut state = seed | 1;
        let draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let anew = described_anew(&path, f64::from(spacing_mm) * 1e-3, draw);
        let platform = limited(v_max_mps, omega_max_radps);
        let ((energy_j, time_s), (anew_j, anew_s)) = (cost(&platform, &path), cost(&platform, &anew));
        prop_assert!((anew_s / time_s - 1.0).abs() <= 0.005, "{} s, {} s", time_s, anew_s);
        prop_assert!((anew_j / energy_j - 1.0).abs() <= 0.005, "{} J, {} J", energy_j, anew_j);
        // Each leg ends near its own point, or where the robot has passed it.
        let follower = Follower::new(&platform).expect("it moves");
        let (few, many) = (follower.follow(&path).unwrap(), follower.follow(&anew).unwrap());
        prop_assert_eq!(many.leg_ends.len(), anew.points.len() - 1);
        prop_assert!(many.leg_ends.is_sorted());
        prop_assert_eq!(many.leg_ends.last(), Some(&many.v_mps.len()));
        let mut seen = many.leg_ends.iter();
        for end in &few.leg_ends {
            prop_assert!(seen.any(|found| found == end), "no leg ends after {} steps", end);
        }
    }

    /// Rounded to a millimetre, a straight path with a point every few centimetres is no straight
    /// one.
    #[test]
    fn rounded_points_of_a_path_hardly_change_it(
        x_m in 2.0f64..6.0,
        y_m in -6.0f64..6.0,
        spacing_mm in 10u32..200,
    ) {
        let path = Path::new(&[Point::new(0.0, 0.0), Point::new(x_m, y_m)], 0.2);
        let many = (1_000.0 * x_m.hypot(y_m)) as u32 / spacing_mm;
        let point = |step: u32| {
            let share = f64::from(step) / f64::from(many);
            let rounded = |m: f64| (1_000.0 * share * m).round() * 1e-3;
            Point::new(rounded(x_m), rounded(y_m))
        };
        let dense = Path::new(&(0..=many).map(point).collect::<Vec<_>>(), 0.2);
        let platform = limited(0.25, 4.0);
        let ((energy_j, time_s), (dense_j, dense_s)) = (cost(&platform, &path), cost(&platform, &dense));
        prop_assert!((dense_s / time_s - 1.0).abs() <= 0.01, "{} s, {} s", time_s, dense_s);
        prop_assert!((dense_j / energy_j - 1.0).abs() <= 0.01, "{} J, {} J", energy_j, dense_j);
    }

    #[test]
    fn a_curve_is_driven_without_a_stop_however_many_points_describe_it(
        radius_m in 0.2f64..5.0,
        speed_mps in 0.05f64..1.5,
        omega_max_radps in 0.5f32..4.0,
    ) {
        let arc = |points: u32| {
            let at = |step: u32| {
                let angle = f64::from(step) / f64::from(points - 1) * std::f64::consts::FRAC_PI_2;
                Point::new(radius_m * angle.sin(), radius_m * (1.0 - angle.cos()))
            };
            Path::new(&(0..points).map(at).collect::<Vec<_>>(), speed_mps)
        };
        let platform = limited(2.0, omega_max_radps);
        let (few, many) = (cost(&platform, &arc(41)), cost(&platform, &arc(400)));
        let all = cost(&platform, &arc(20_000));
        for other in [many, all] {
            prop_assert!((other.0 / few.0 - 1.0).abs() <= 0.02, "{:?} {:?}", few, other);
            prop_assert!((other.1 / few.1 - 1.0).abs() <= 0.02, "{:?} {:?}", few, other);
        }
        let follower = Follower::new(&platform).expect("it moves");
        let followed = follower.follow(&arc(400)).expect("it gets there");
        // At the end it slows down to 4 cm/s, and stops.
        let slowest = followed.v_mps[..followed.v_mps.len() - 1].iter().copied().fold(9.0, f32::min);
        prop_assert!(slowest > 0.6 * speed_mps.min(0.04) as f32, "{}", slowest);
        for pose in &followed.poses {
            let beside_m = (pose.at.x_m.hypot(pose.at.y_m - radius_m) - radius_m).abs();
            prop_assert!(beside_m <= 0.05, "{} m beside the curve", beside_m);
        }
    }
}

/// The cells of a grid that a line from the origin crosses, as a planner of four or of eight
/// neighbours lists them. `cell_m` is their size.
fn stairs(end: Point, cell_m: f64, has_diagonals: bool) -> Vec<Point> {
    let count = |m: f64| (m.abs() / cell_m).round();
    let (x, y) = (count(end.x_m), count(end.y_m));
    let most = x.max(y).max(1.0);
    let at =
        |x: f64, y: f64| Point::new((cell_m * x).copysign(end.x_m), (cell_m * y).copysign(end.y_m));
    let mut cells: Vec<(f64, f64)> = vec![(0.0, 0.0)];
    for step in 1..=most as u32 {
        let share = f64::from(step) / most;
        let (before, next) = (cells[cells.len() - 1], ((x * share).round(), (y * share).round()));
        if !has_diagonals && before.0 != next.0 && before.1 != next.1 {
            cells.push((next.0, before.1));
        }
        cells.push(next);
    }
    cells.into_iter().map(|(x, y)| at(x, y)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    /// Start and goal lie anywhere, the cells between them on the grid. Points inserted on the stairs
    /// change nothing.
    #[test]
    fn the_stairs_of_a_grid_cost_what_the_straight_way_costs(
        x_m in 3.0f64..9.0,
        y_m in -9.0f64..9.0,
        cell_mm in 20u32..150,
        has_diagonals in any::<bool>(),
        inserted in 0u32..4,
    ) {
        let cell_m = f64::from(cell_mm) * 1e-3;
        let cells = stairs(Point::new(x_m, y_m), cell_m, has_diagonals);
        let mut points = vec![Point::new(-0.3 * cell_m, 0.2 * cell_m)];
        for cell in cells.iter().copied().chain([Point::new(x_m, y_m)]) {
            let from = points[points.len() - 1];
            let share = |part: u32| f64::from(part) / f64::from(inserted + 1);
            points.extend((1..=inserted + 1).map(|part| {
                let share = share(part);
                Point::new(from.x_m + share * (cell.x_m - from.x_m), from.y_m + share * (cell.y_m - from.y_m))
            }));
        }
        let straight = Path::new(&[points[0], points[points.len() - 1]], 0.2);
        let path = Path::new(&points, 0.2);
        let platform = limited(0.25, 4.0);
        let (whole, cut) = (cost(&platform, &straight), cost(&platform, &path));
        // Without diagonals, some corners lie more than half a cell beside every line.
        let most = if has_diagonals { 0.04 } else { 0.12 };
        prop_assert!((cut.1 / whole.1 - 1.0).abs() <= most, "{:?} {:?} {:?}", whole, cut, path.simplified());
        prop_assert!((cut.0 / whole.0 - 1.0).abs() <= most, "{:?} {:?} {:?}", whole, cut, path.simplified());
        if let Some(simplified) = path.simplified() {
            prop_assert_eq!(simplified.points, points.len());
            prop_assert!((simplified.within_m - 0.5 * cell_m).abs() < 1e-6);
        }
        // What is driven stays beside the stairs.
        let followed = Follower::new(&platform).unwrap().follow(&path).unwrap();
        for pose in &followed.poses {
            let away_m = |pair: &[Point]| {
                let (from, to) = (pair[0], pair[1]);
                let (x, y) = (to.x_m - from.x_m, to.y_m - from.y_m);
                let square = (x * x + y * y).max(1e-12);
                let share = ((pose.at.x_m - from.x_m) * x + (pose.at.y_m - from.y_m) * y) / square;
                let share = share.clamp(0.0, 1.0);
                (pose.at.x_m - from.x_m - share * x).hypot(pose.at.y_m - from.y_m - share * y)
            };
            let beside_m = points.windows(2).map(away_m).fold(f64::INFINITY, f64::min);
            prop_assert!(beside_m <= 0.5 * cell_m + 0.06, "{} m beside", beside_m);
        }
        prop_assert!(followed.leg_ends.is_sorted());
    }

    /// A path with times takes them, if they can be driven, however many points describe it.
    #[test]
    fn poses_with_times_keep_their_times(
        corners in prop::collection::vec((-3.0f64..3.0, -3.0f64..3.0), 2..6),
        speed_mps in 0.02f64..0.12,
        begin_s in -1e6f64..1e9,
        wait_s in 0.0f64..30.0,
        spacing_mm in 5u32..1_000,
    ) {
        let corners: Vec<Point> = corners.iter().map(|(x, y)| Point::new(*x, *y)).collect();
        let spacing_m = f64::from(spacing_mm) * 1e-3;
        let mut path = Path { speed_mps: vec![f64::INFINITY], ..Path::default() };
        let mut time_s = begin_s;
        path.points.push(corners[0]);
        path.time_s.push(time_s);
        for pair in corners.windows(2) {
            let length_m = (pair[1].x_m - pair[0].x_m).hypot(pair[1].y_m - pair[0].y_m);
            let count = (length_m / spacing_m).ceil().max(1.0) as u32;
            for part in 1..=count {
                let share = f64::from(part) / f64::from(count);
                path.points.push(Point::new(
                    pair[0].x_m + share * (pair[1].x_m - pair[0].x_m),
                    pair[0].y_m + share * (pair[1].y_m - pair[0].y_m),
                ));
                path.time_s.push(time_s + share * length_m / speed_mps);
            }
            // Time to turn, and to wait: the point again, later.
            time_s = path.time_s[path.time_s.len() - 1] + wait_s + 2.5;
            path.points.push(pair[1]);
            path.time_s.push(time_s);
        }
        path.speed_mps.resize(path.points.len(), f64::INFINITY);
        let followed = Follower::new(&limited(0.25, 4.0)).unwrap().follow(&path).unwrap();
        prop_assert_eq!(followed.late_s, 0.0);
        let taken_s = f64::from(followed.period_s) * followed.v_mps.len() as f64;
        prop_assert!((taken_s - (time_s - begin_s)).abs() <= 0.1, "{} s for {}", taken_s, time_s - begin_s);
    }
}

#[test]
fn a_tolerance_smooths_scattered_points_and_0_drives_every_corner() {
    // Scatter of 1 cm to both sides of a straight line, by a fixed sequence.
    let scatter_m = |step: u32| 0.01 * (f64::from(step * 7 % 11) / 5.0 - 1.0);
    let points: Vec<Point> =
        (0..400).map(|step| Point::new(0.02 * f64::from(step), scatter_m(step))).collect();
    let path = |tolerance_m| Path { tolerance_m, ..Path::new(&points, 0.2) };
    let platform = limited(0.25, 4.0);
    let straight = cost(&platform, &Path::new(&[points[0], points[399]], 0.2));
    let [smooth, rough] = [Some(0.05), Some(0.0)].map(&path);
    assert!((cost(&platform, &smooth).1 / straight.1 - 1.0).abs() < 0.02);
    assert!(cost(&platform, &rough).1 > straight.1);
    let simplified = smooth.simplified().expect("it is smoothed");
    assert_eq!((simplified.points, (1e3 * simplified.within_m).round()), (400, 50.0));
    assert!(simplified.lines < 40, "{simplified:?}");
    // A grid is not guessed from it.
    assert_eq!((rough.simplified(), path(None).simplified()), (None, None));
    // Corners that turn to one side are no stairs, nor is a lane that is changed once.
    for corners in [
        vec![(0.0, 0.0), (5.0, 0.0), (5.0, 0.2), (0.0, 0.2), (0.0, 0.4), (5.0, 0.4)],
        vec![(0.0, 0.0), (5.0, 0.0), (5.0, 1.0), (9.0, 1.0), (9.0, 0.0), (12.0, 0.0)],
    ] {
        let points: Vec<Point> = corners.into_iter().map(|(x, y)| Point::new(x, y)).collect();
        assert_eq!(Path::new(&points, 0.2).simplified(), None);
    }
}

#[test]
fn times_that_cannot_be_driven_are_reported_with_the_delay() {
    let follower = follower(0.2, 3.0);
    let points = [0.0, 2.0, 4.0].map(|x_m| Point::new(x_m, 0.0));
    // 10 s a leg at the greatest speed.
    for (time_s, late_s) in [
        ([0.0, 10.0, 20.0], 0.0),
        ([7.0, 27.0, 47.0], 0.0),
        ([0.0, 5.0, 40.0], 5.0),
        ([0.0, 5.0, 10.0], 10.0),
        ([0.0, 0.0, 0.0], 20.0),
    ] {
        let path = Path { time_s: time_s.to_vec(), ..Path::new(&points, f64::INFINITY) };
        let followed = follower.follow(&path).expect("it gets there");
        // The last quarter of a metre takes a second more.
        assert!((followed.late_s - late_s).abs() < 1.0, "{time_s:?}: {}", followed.late_s);
        let taken_s = followed.period_s * followed.v_mps.len() as f32;
        let expected_s = (time_s[2] - time_s[0]).max(20.0) as f32;
        assert!((taken_s - expected_s).abs() < 1.0, "{time_s:?}: {taken_s} s");
    }
    let slow = Path { time_s: vec![0.0, 10.0, 20.0], ..Path::new(&points, 0.1) };
    assert!((follower.follow(&slow).expect("it gets there").late_s - 20.0).abs() < 1.0);
}

#[test]
fn a_robot_waits_at_a_point_and_the_load_is_drawn_on_its_leg() {
    let follower = follower(0.2, 3.0);
    let at = Point::new;
    let points = [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 0.0), at(2.0, 0.0)];
    let still = Path::new(&points, 0.2);
    let path = Path {
        dwell_s: vec![3.0, 10.0, 5.0, 2.0],
        load_w: vec![9.0, 0.0, 1.5, -0.5],
        ..still.clone()
    };
    let followed = follower.follow(&path).expect("it gets there");
    let rests = |from: usize, to: usize| {
        followed.v_mps[from..to].iter().rev().take_while(|v_mps| **v_mps == 0.0).count() as f32
    };
    let ends = &followed.leg_ends;
    let [first, second, third] = [(0, ends[0]), (ends[0], ends[1]), (ends[1], ends[2])];
    for ((from, to), rest_s) in [(first, 10.0), (second, 5.0), (third, 2.0)] {
        let rested_s = rests(from, to) * followed.period_s;
        assert!((rested_s - rest_s).abs() < 0.1, "{rested_s} s of {rest_s} s");
    }
    assert!(followed.v_mps[..89].iter().all(|v_mps| *v_mps == 0.0));
    assert_eq!(followed.load_w, [0.0, 1.5, -0.5]);
    // The robot stops at the point where it waits, and does not pass it.
    assert!(followed.poses[ends[0]].at.x_m <= 1.0);
    let free = follower.follow(&still).expect("it gets there");
    assert!(followed.v_mps.len() > free.v_mps.len() + 600);
}

#[test]
fn a_change_of_speed_on_a_straight_leg_is_driven_there_without_a_stop() {
    let points = [0.0, 1.0, 2.0].map(|x_m| Point::new(x_m, 0.0));
    let path = Path { speed_mps: vec![0.2, 0.2, 0.1], ..Path::new(&points, 0.2) };
    let followed = follower(0.25, 4.0).follow(&path).expect("it gets there");
    let (fast, slow) = followed.v_mps.split_at(followed.leg_ends[0]);
    assert!(fast.iter().all(|v_mps| *v_mps == 0.2), "{fast:?}");
    assert!(slow[..slow.len() / 2].iter().all(|v_mps| *v_mps == 0.1), "{slow:?}");
    let changed_m = followed.poses[followed.leg_ends[0]].at.x_m;
    assert!((0.95..=1.01).contains(&changed_m), "{changed_m}");
}

#[test]
fn a_path_in_one_place_has_a_step_and_faces_where_it_is_told() {
    for points in [2, 3, 100] {
        let here = vec![Point::new(1.0, -2.0); points];
        let path = Path { heading_rad: Some(0.5), ..Path::new(&here, 0.2) };
        let followed = follower(0.25, 4.0).follow(&path).expect("it is there");
        assert_eq!((followed.v_mps.as_slice(), followed.leg_ends.len()), (&[0.0][..], points - 1));
        assert_eq!(followed.leg_ends.last(), Some(&1));
        assert!(followed.poses.iter().all(|pose| pose.heading_rad == 0.5));
    }
}

#[test]
fn a_robot_faces_the_first_point_that_is_elsewhere() {
    let (from, end) = (Point::new(0.0, 0.0), Point::new(0.0, 1.0));
    let once = follower(0.25, 4.0).follow(&Path::new(&[from, end], 0.2)).expect("it gets there");
    let twice = follower(0.25, 4.0).follow(&Path::new(&[from, from, end], 0.2));
    let twice = twice.expect("it gets there");
    assert_eq!((&once.v_mps, &once.poses), (&twice.v_mps, &twice.poses));
    assert_eq!(twice.leg_ends, [0, once.leg_ends[0]]);
}

#[test]
fn following_a_path_of_many_points_takes_a_small_multiple_of_its_memory() {
    let points: Vec<Point> = (0..200_000)
        .map(|step| Point::new(f64::from(step) * 1e-4, 1e-3 * f64::from(step % 7)))
        .collect();
    let path = Path::new(&points, f64::INFINITY);
    let follower = follower(0.25, 4.0);
    let (followed, peak) = counting::peak(|| follower.follow(&path).expect("it gets there"));
    let of_path = size_of_val(points.as_slice()) + size_of_val(path.speed_mps.as_slice());
    assert!(peak < 3 * of_path as u64, "{peak} bytes");
    assert_eq!(followed.leg_ends.len(), points.len() - 1);
}

/// The steps outside a model's training data of a robot at rest that follows a path.
fn steps_outside(platform: &Platform, path: &Path) -> usize {
    let follower = Follower::new(platform).expect("it moves");
    let followed = follower.follow(path).expect("it gets there");
    let mut at_rest = EnergyState::new(0);
    (at_rest.metered.v_mps, at_rest.metered.omega_radps) = (0.0, 0.0);
    platform.energy.forecast(&at_rest, followed.commands()).steps_outside
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Robots of the plant are commanded to start, to stop and to turn as suddenly as a follower
    /// does, up to the Robotarium's limits: 0.2 m/s and both wheels in opposite directions.
    #[test]
    fn the_shipped_model_knows_every_step_of_a_path_at_the_robotariums_speeds(
        corners in prop::collection::vec((-1.6f64..1.6, -1.0f64..1.0), 2..6),
        speed_mps in prop_oneof![0.02f64..0.2, Just(0.2), Just(f64::INFINITY)],
    ) {
        let points: Vec<Point> = corners.iter().map(|(x, y)| Point::new(*x, *y)).collect();
        prop_assert_eq!(steps_outside(&shipped(), &Path::new(&points, speed_mps)), 0);
    }
}

#[test]
fn a_plan_turns_and_reverses_within_its_models_range_and_drives_as_fast_as_asked() {
    let mut platform = shipped();
    (platform.energy.v_mps, platform.energy.omega_radps) = ([0.0, 0.1], [-1.0, 1.5]);
    let there_and_back = [0.0, 1.0, 0.0].map(|x_m| Point::new(x_m, 0.0));
    let highest = |speed_mps| {
        let follower = Follower::new(&platform).expect("it moves");
        let followed = follower.follow(&Path::new(&there_and_back, speed_mps));
        let followed = followed.expect("it gets there");
        let lowest = followed.v_mps.iter().copied().fold(0.0, f32::min);
        let turned = followed.omega_radps.iter().map(|omega| omega.abs());
        let fastest = followed.v_mps.iter().copied().fold(0.0, f32::max);
        (lowest, fastest, turned.fold(0.0, f32::max))
    };
    // Asked for 0.2 m/s, it is answered with steps outside the training data.
    assert_eq!(highest(0.2), (0.0, 0.2, 1.0));
    assert_eq!(highest(f64::INFINITY), (0.0, 0.1, 1.0));
    assert!(steps_outside(&platform, &Path::new(&there_and_back, 0.2)) > 100);
    // A model that has seen no turn cannot keep a robot from turning.
    platform.energy.omega_radps = [0.0, 0.0];
    let follower = Follower::new(&platform).expect("it moves");
    assert!(follower.follow(&Path::new(&there_and_back, 0.1)).is_ok());
}

#[test]
fn wrong_paths_are_refused_with_the_value() {
    let follower = follower(0.2, 3.0);
    let at = Point::new;
    let refused = |path: &Path| follower.follow(path).expect_err("refused");
    assert_eq!(refused(&Path::new(&[at(0.0, 0.0)], 0.1)), PathError::Points { found: 1 });
    for value in [f64::NAN, f64::INFINITY, 2e6] {
        let error = refused(&Path::new(&[at(0.0, 0.0), at(1.0, value)], 0.1));
        let PathError::Coordinate { column, point, .. } = error else {
            panic!("{error}");
        };
        assert_eq!((column, point), ("y_m", 1));
    }
    let two = Path::new(&[at(0.0, 0.0), at(1.0, 0.0)], 0.1);
    let [nan, inf] = [f64::NAN, f64::INFINITY];
    for (path, expected) in [
        (Path { dwell_s: vec![1.0], ..two.clone() }, "dwell_s has 1 values: allowed are none or 2"),
        (Path { dwell_s: vec![0.0, -1.0], ..two.clone() }, "dwell_s of point 1 is -1.0"),
        (Path { load_w: vec![nan, 0.0], ..two.clone() }, "load_w of point 0 is NaN"),
        (Path { time_s: vec![0.0, inf], ..two.clone() }, "time_s of point 1 is inf"),
        (Path { time_s: vec![2.0, 1.0], ..two.clone() }, "point 1 has the time 1 s"),
        (Path { time_s: vec![0.0; 2], dwell_s: vec![1.0; 2], ..two.clone() }, "either time_s or"),
        (Path { tolerance_m: Some(f32::NAN), ..two.clone() }, "a tolerance of NaN m"),
        (Path { tolerance_m: Some(1.5), ..two.clone() }, "a tolerance of 1.5 m"),
        (Path { dwell_s: vec![0.0, 1e11], ..two }, "a wait of 100000000000 s at point 1"),
    ] {
        let error = refused(&path).to_string();
        assert!(error.contains(expected), "{error}");
    }
    for speed in [0.0, -0.1, f64::NAN] {
        let error = refused(&Path::new(&[at(0.0, 0.0), at(1.0, 0.0)], speed));
        assert!(matches!(error, PathError::Speed { point: 1, .. }), "{error}");
    }
    let still = fleet(0.0, 0.0);
    let error = Follower::new(&still.platforms()[0]).expect_err("it cannot move");
    assert!(error.to_string().contains("v_max_mps"), "{error}");
}

#[test]
fn a_path_of_too_many_steps_is_distinguished_from_a_point_that_is_circled() {
    let follower = follower(0.2, 3.0).within(100);
    let points = [Point::new(0.0, 0.0), Point::new(50.0, 0.0)];
    for speed_mps in [0.2, 1e-5] {
        let error = follower.follow(&Path::new(&points, speed_mps));
        let error = error.expect_err("refused");
        assert!(matches!(error, PathError::TooLong { point: 1, allowed: 100, .. }), "{error}");
    }
}

#[test]
fn infinite_speed_is_as_fast_as_the_platform_can() {
    let follower = follower(0.2, 3.0);
    let points = [Point::new(0.0, 0.0), Point::new(2.0, 0.0)];
    let fastest = follower.follow(&Path::new(&points, f64::INFINITY));
    assert_eq!(fastest, follower.follow(&Path::new(&points, 0.2f32.into())));
}

/// Commands of the simulator for poses and goals, and a drive with them: its controllers, in
/// Python.
const SCRIPT: &str = r#"
import sys, json, numpy as np
sys.path.insert(0, sys.argv[1])
from rps.utilities.controllers import create_pose_controller_hybrid
given = json.loads(sys.argv[2])
speed, period = given["speed"], given["period"]
# The follower's gain of 0.8/s on the distance, and 2/s on the angle.
control = create_pose_controller_hybrid(linear_velocity_gain=0.8, angular_velocity_limit=np.pi,
    velocity_magnitude_limit=speed / 0.8, position_error=0.06, position_epsilon=0.01)
def step(pose, goal):
    states = np.array(pose).reshape(3, 1)
    poses = np.array([goal[0], goal[1], 0.0]).reshape(3, 1)
    dxu, _ = control(states, poses, np.ones(1))
    return float(dxu[0, 0]), float(dxu[1, 0])
commands = [step(pose, goal) for pose, goal in given["cases"]]
drives = []
for pose, goal in given["cases"]:
    pose, steps, travelled = list(pose), 0, 0.0
    while np.hypot(pose[0] - goal[0], pose[1] - goal[1]) > 0.05 and steps < 100000:
        v, w = step(pose, goal)
        pose[0] += period * v * np.cos(pose[2]); pose[1] += period * v * np.sin(pose[2])
        pose[2] += period * w
        steps += 1; travelled += period * abs(v)
    drives.append([steps, travelled])
print(json.dumps({"commands": commands, "drives": drives}))
"#;

/// A Python. The one of `tools/python.sh` has NumPy.
fn python() -> String {
    std::env::var("JOULEBUS_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

/// The simulator, if it is installed with Python and NumPy.
fn simulator() -> Option<PathBuf> {
    let here = FilePath::new(env!("CARGO_MANIFEST_DIR"));
    let folder = here.join("../../../../shared/rps");
    let runs = Command::new(python())
        .args(["-c", "import numpy"])
        .output()
        .is_ok_and(|output| output.status.success());
    if fs::exists(folder.join("rps/utilities/controllers.py")).unwrap_or(false) && runs {
        return Some(folder);
    }
    assert!(
        std::env::var_os("CI").is_none_or(|value| value != "true"),
        "{} or Python with NumPy is missing",
        folder.display()
    );
    println!("skipped: {} or Python with NumPy is missing", folder.display());
    None
}

#[test]
fn commands_and_drives_are_those_of_the_robotarium_simulator() {
    let Some(folder) = simulator() else {
        return;
    };
    const SPEED_MPS: f64 = 0.12;
    let follower = follower(10.0, 100.0);
    let mut cases = Vec::new();
    for place in 0..40 {
        let turn = f64::from(place);
        let pose = [1.3 * (turn * 0.7).sin(), (turn * 1.1).cos(), turn * 0.55 - 3.0];
        cases.push((pose, [(turn * 0.37).cos(), 1.4 * (turn * 0.9).sin()]));
    }
    let followed_by = |pose: [f64; 3], goal: [f64; 2]| {
        let path = Path {
            heading_rad: Some(pose[2]),
            ..Path::new(&[Point::new(pose[0], pose[1]), Point::new(goal[0], goal[1])], SPEED_MPS)
        };
        follower.follow(&path).expect("it gets there")
    };
    let period_s = 1.0 / 30.0;
    let listed: Vec<String> =
        cases.iter().map(|(pose, goal)| format!("[{pose:?}, {goal:?}]")).collect();
    let given = format!(
        r#"{{"speed": {SPEED_MPS}, "period": {period_s}, "cases": [{}]}}"#,
        listed.join(", ")
    );
    let output = Command::new(python())
        .args(["-c", SCRIPT])
        .arg(&folder)
        .arg(&given)
        .output()
        .expect("Python runs");
    let (stdout, stderr) = (&output.stdout, &output.stderr);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(stderr));
    let theirs: Theirs = serde_json::from_slice(stdout).expect("its answer is JSON");
    for (place, (pose, goal)) in cases.into_iter().enumerate() {
        let here = Pose { at: Point::new(pose[0], pose[1]), heading_rad: pose[2] };
        let (v_mps, omega_radps) = follower.command(&here, Point::new(goal[0], goal[1]), SPEED_MPS);
        let (v, omega) = theirs.commands[place];
        assert!((f64::from(v_mps) - v).abs() < 1e-6, "{place}: {v_mps} {v}");
        assert!((f64::from(omega_radps) - omega).abs() < 1e-5, "{place}: {omega_radps} {omega}");
        // The simulator takes the heading at the beginning of a step, the follower in its middle.
        let followed = followed_by(pose, goal);
        let (steps, travelled_m) = theirs.drives[place];
        let mine_m: f64 = followed.v_mps.iter().map(|v| f64::from(v.abs()) * period_s).sum();
        let mine = (followed.v_mps.len() - 1) as f64;
        assert!((mine - steps).abs() <= 2.0 + 0.01 * steps, "{place}: {mine} {steps}");
        assert!(
            (mine_m - travelled_m).abs() < 0.01 + 0.01 * travelled_m,
            "{place}: {mine_m} {travelled_m}"
        );
    }
}

#[derive(serde::Deserialize)]
struct Theirs {
    commands: Vec<(f64, f64)>,
    drives: Vec<(f64, f64)>,
}
