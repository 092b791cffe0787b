//! The follower drives as the Robotarium simulator's controllers do, within the platform's limits.

use std::fs;
use std::path::{Path as FilePath, PathBuf};
use std::process::Command;

use joulebus_config::{Config, builtin_model};
use joulebus_energy::EnergyState;
use joulebus_plan::follow::{Follower, Pose};
use joulebus_plan::{Fleet, Path, PathError, Platform, Point};
use joulebus_predictor::{Model, Network, Persistence, ResidualStats};
use proptest::prelude::*;

fn fleet(v_max_mps: f32, omega_max_radps: f32) -> Fleet {
    let text =
        "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n";
    let config = Config::parse(text, FilePath::new("/nowhere")).expect("the config is valid");
    let mut settings = config.settings().clone();
    settings.platforms[0].v_max_mps = v_max_mps;
    settings.platforms[0].omega_max_radps = omega_max_radps;
    let residual = ResidualStats { std_w: 1.0, q05_w: -1.6, q95_w: 1.6 };
    let model = Model::Persistence(Persistence::new(residual).expect("finite"));
    Fleet::new(&settings, &[model])
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
