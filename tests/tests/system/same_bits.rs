//! The live and the offline path compute the same bits: recorded trials of three platforms, played
//! through publisher, shared memory and worker, give the bits of the offline evaluation.
//!
//! Uses processes, and recordings under `../shared/data`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use joulebus_bus::Bus;
use joulebus_config::Config;
use joulebus_dataset::trial::Trial;
use joulebus_eval::evaluate::{Evaluation, RobotEvaluation, Step, evaluate};
use joulebus_models::load_models;
use joulebus_testkit::recordings::trials;
use joulebus_tests::{Child, PATIENCE, program};
use joulebus_wire::{Diagnostic, Diagnostics, Forecast, Forecasts, Quality};

/// 100 Robotino trials, 12 of the Husky and 12 of the rover, with the ids of the config below.
fn fleet() -> Option<Vec<(u32, PathBuf)>> {
    let numbered = |first: u32, files: Vec<PathBuf>| (first..).zip(files);
    let robotino: Vec<PathBuf> = trials("robotino")?.into_iter().step_by(6).take(100).collect();
    // The shortest ones: minutes of recording test no more than seconds.
    let mut husky = trials("borealtc_husky")?;
    husky.sort_by_key(|path| path.metadata().unwrap().len());
    let rover = trials("ase_rover")?.into_iter().step_by(5);
    let fleet = numbered(0, robotino).chain(numbered(100, husky.into_iter().take(12).collect()));
    Some(fleet.chain(numbered(200, rover.take(12).collect())).collect())
}

/// A network with velocities, persistence, and a network without velocities; two of the rovers are
/// assigned the network whose velocities they lack.
fn config(root: &Path) -> String {
    format!(
        r#"
[fleet]
name = "bits"
capacity = 128
[domain]
root = "{}"
prefix = "t_"
[tick]
# So that a planner that waits for a processor misses few of the frames.
rate_hz = 250.0
deadline_ms = 2.0
[intake]
leave_after_s = 600.0
max_jump_s = 600.0
[ledger]
checkpoint = ""
[[platform]]
file = "builtin:robotino"
robots = ["0-99"]
model = "builtin:gternal-sim"
[[platform]]
file = "builtin:husky"
robots = ["100-111"]
model = "persistence"
residual_std_w = 75.0
[[platform]]
file = "builtin:rover"
robots = ["200-209"]
model = "builtin:gternal-sim-power"
[[platform]]
file = "builtin:rover"
name = "rover-with-the-wrong-model"
robots = ["210-211"]
model = "builtin:gternal-sim"
"#,
        root.display()
    )
}

/// Output of the worker: by robot and sample, and the last of each robot.
#[derive(Default)]
struct Published {
    forecasts: HashMap<(u32, u64), Forecast>,
    diagnostics: HashMap<(u32, u64), Diagnostic>,
    last: HashMap<u32, Diagnostic>,
}

impl Published {
    /// Reads frames until the source has exited and all its samples are answered, in diagnostics
    /// too, which late ticks leave out.
    fn read(config: &Config, ended: &AtomicBool) -> Self {
        let bus = Bus::join(&config.domain().unwrap(), "planner").unwrap();
        let limits = config.limits();
        let mut waiter = bus.planner_waiter(&limits).unwrap();
        let mut forecasts = bus.reader::<Forecasts>(&limits).unwrap();
        let mut diagnostics = bus.reader::<Diagnostics>(&limits).unwrap();
        let mut published = Self::default();
        let mut rounds_after = 0;
        let begun = Instant::now();
        while rounds_after < 20 {
            assert!(begun.elapsed() < PATIENCE, "the source has not exited");
            waiter.wait_until(None, None).unwrap();
            let (has_ended, mut has_diagnosed) = (ended.load(Ordering::Relaxed), false);
            while let Some(frame) = forecasts.take_next().unwrap() {
                for forecast in frame.payload() {
                    let live = !matches!(forecast.quality(), Quality::OpenLoop { .. });
                    // Open loop by the worker's clock is provisional and excluded from the
                    // comparison.
                    if live {
                        published
                            .forecasts
                            .insert((forecast.robot, forecast.sample_seq), *forecast);
                    }
                }
            }
            while let Some(frame) = diagnostics.take_next().unwrap() {
                has_diagnosed = true;
                for diagnostic in frame.payload() {
                    published
                        .diagnostics
                        .insert((diagnostic.robot, diagnostic.sample_seq), *diagnostic);
                    published.last.insert(diagnostic.robot, *diagnostic);
                }
            }
            rounds_after += u32::from(has_ended && has_diagnosed);
        }
        published
    }
}

fn bits(watts: Option<f32>) -> Option<u32> {
    watts.map(f32::to_bits)
}

/// Compares a published forecast with its step; a robot is stale once its recording has ended.
fn same_forecast(robot: u32, live: &Forecast, step: &Step) {
    if live.quality() == Quality::Invalid(joulebus_wire::InvalidReason::Stale) {
        return;
    }
    let place = format!("robot {robot}, sample {}", step.sample_seq);
    assert_eq!(live.quality(), step.quality, "{place}");
    assert_eq!(bits(live.expected_w()), bits(step.power_w), "{place}");
    assert_eq!(bits(live.interval_w().map(|(lo_w, _)| lo_w)), bits(step.lo_w), "{place}");
    assert_eq!(bits(live.interval_w().map(|(_, hi_w)| hi_w)), bits(step.hi_w), "{place}");
}

fn same_residual(robot: u32, live: &Diagnostic, step: &Step) {
    let residual_w = Some(live.residual_w).filter(|residual_w| !residual_w.is_nan());
    let place = format!("robot {robot}, sample {}", step.sample_seq);
    assert_eq!(bits(residual_w), bits(step.network_residual_w), "{place}");
}

fn same_scores(live: &Diagnostic, offline: &RobotEvaluation) {
    let (robot, scores) = (offline.robot, &offline.scores);
    assert_eq!(live.scored, scores.count, "readings scored of robot {robot}");
    for (name, live, offline) in [
        ("MAE", live.mae_w, scores.mae_w()),
        ("R²", live.r2, scores.r2()),
        ("MAE of persistence", live.persistence_mae_w, scores.persistence_mae_w()),
        ("R² of persistence", live.persistence_r2, scores.persistence_r2()),
        ("skill", live.skill, scores.skill()),
    ] {
        assert_eq!(
            live.to_bits(),
            offline.to_bits(),
            "{name} of robot {robot}: {live} and {offline}"
        );
    }
    assert_eq!(live.coverage.to_bits(), offline.coverage.to_bits(), "coverage of robot {robot}");
}

/// Compares all output. Returns the number of forecasts and residuals.
fn compare(published: &Published, offline: &Evaluation) -> (usize, usize) {
    let (mut forecasts, mut residuals) = (0, 0);
    for robot in &offline.robots {
        for step in robot.steps.iter().filter(|step| step.accepted) {
            let key = (robot.robot, step.sample_seq);
            if let Some(live) = published.forecasts.get(&key) {
                same_forecast(robot.robot, live, step);
                forecasts += 1;
            }
            if let Some(live) = published.diagnostics.get(&key) {
                same_residual(robot.robot, live, step);
                residuals += 1;
            }
        }
        same_scores(&published.last[&robot.robot], robot);
    }
    (forecasts, residuals)
}

fn start_worker(config: &Path) -> Child {
    let mut command = Command::new(program("joulebus-under-test"));
    command.args(["run", "--config"]).arg(config);
    Child::spawn("worker", command)
}

fn start_source(config: &Path, fleet: &[(u32, PathBuf)]) -> Child {
    let tested = program("joulebus-under-test").display().to_string();
    let mut command = Command::new(joulebus_testkit::lab_beside(&tested));
    command.args("publish trial --rate max --window 1 --frame-rate 100 --config".split(' '));
    command.arg(config);
    command.args(fleet.iter().map(|(robot, path)| format!("{}@{robot}", path.display())));
    Child::spawn("source", command)
}

#[test]
fn a_recorded_fleet_has_the_same_bits_live_and_offline() {
    let Some(fleet) = fleet() else { return };
    let root = PathBuf::from(format!("/dev/shm/jbt-bits-{}", std::process::id()));
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("fleet.toml");
    std::fs::write(&path, config(&root)).unwrap();
    let config = Config::load(&path).unwrap();
    let models = load_models(&config).unwrap();
    let read = |(robot, path): &(u32, PathBuf)| (*robot, Trial::read(path).unwrap());
    let trials: Vec<(u32, Trial)> = fleet.iter().map(read).collect();
    let offline = evaluate(config.settings(), &models, &trials).unwrap();

    let mut worker = start_worker(&path);
    let mut source = start_source(&path, &fleet);
    let ended = AtomicBool::new(false);
    let published = std::thread::scope(|scope| {
        let reader = scope.spawn(|| Published::read(&config, &ended));
        source.finish();
        ended.store(true, Ordering::Relaxed);
        reader.join().unwrap()
    });
    worker.stop();

    let (forecasts, residuals) = compare(&published, &offline);
    let steps: usize = offline.robots.iter().map(|robot| robot.steps.len()).sum();
    println!(
        "figure: {forecasts} forecasts and {residuals} residuals of {steps} samples compared, 0 differ"
    );
    assert!(forecasts > steps / 2, "only {forecasts} of {steps} forecasts received");
    assert!(residuals > steps / 2, "only {residuals} of {steps} residuals received");
    let blind = offline.robots.iter().find(|robot| robot.robot == 210).unwrap();
    let no_command = Quality::Invalid(joulebus_wire::InvalidReason::NoCommand);
    assert!(
        blind.steps.iter().skip(5).all(|step| step.quality == no_command),
        "a rover publishes no velocities"
    );
    assert!(!root.exists(), "left behind: {}", root.display());
}
