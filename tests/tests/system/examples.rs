//! Every example of a published crate succeeds beside a real worker, and prints what it documents.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use joulebus_testkit::example_beside;
use joulebus_tests::{
    Arena, Child, Ended, PATIENCE, Setup, alone, eventually, program, sample, without_loss,
};
use joulebus_wire::Sample;

/// Folders and names of the crates with examples.
const CRATES: [[&str; 2]; 9] = [
    ["crates/publisher", "joulebus-publisher"],
    ["crates/consumer", "joulebus-consumer"],
    ["crates/planning/planner", "joulebus-planner"],
    ["crates/predictor-worker", "joulebus-predictor-worker"],
    ["crates/host/models", "joulebus-models"],
    ["crates/lab/train", "joulebus-train"],
    ["crates/lab/eval", "joulebus-eval"],
    ["crates/capture/format", "joulebus-capture-format"],
    ["crates/capture/verify", "joulebus-capture-verify"],
];

/// No arguments.
const NOTHING: [&str; 0] = [];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn start<A: AsRef<OsStr>>(name: &str, arguments: impl IntoIterator<Item = A>) -> Child {
    let file = |folder: &str| root().join(folder).join("examples").join(format!("{name}.rs"));
    let found = CRATES.iter().find(|[folder, _]| file(folder).exists());
    let [_, package] = found.unwrap_or_else(|| panic!("no example {name}"));
    let path = example_beside(&program("joulebus-under-test"), package, name);
    let mut command = Command::new(path);
    command.args(arguments);
    Child::spawn(name, command)
}

/// The lines that an example prints until it exits successfully.
fn run<A: AsRef<OsStr>>(name: &str, arguments: impl IntoIterator<Item = A>) -> Vec<String> {
    start(name, arguments).wait().exits(0).stdout
}

#[track_caller]
fn assert_starts(lines: &[String], starts: &[&str]) {
    assert_eq!(lines.len(), starts.len(), "{lines:#?}");
    for (line, start) in lines.iter().zip(starts) {
        assert!(line.starts_with(start), "{line:?} does not begin with {start:?}");
    }
}

/// Reads an example's lines from the one that it has not read yet, up to one that is wanted.
fn until(child: &Child, read: &mut usize, wanted: impl Fn(&str) -> bool) -> String {
    loop {
        let lines = child.lines(*read, PATIENCE);
        assert!(!lines.is_empty(), "{}", child.tail());
        *read += 1;
        if wanted(&lines[0]) {
            return lines[0].clone();
        }
    }
}

fn with_batteries() -> Setup {
    Setup {
        more: "[platform.battery]\ncapacity_wh = 10.0\ninitial_soc_lo = 0.9\n".to_owned(),
        max_planners: 8,
        ..Setup::simulated()
    }
}

/// Sends frames while an example runs. Returns how it ended.
fn run_beside(
    arena: &Arena,
    name: &str,
    frame: impl Fn(u64, u64) -> Vec<Sample>,
    mut example: Child,
) -> Ended {
    let mut source = arena.source(name);
    let period_ns = with_batteries().period_ns();
    let mut seq = 0;
    eventually("the example ends", || {
        source.send(&frame(seq, period_ns));
        seq += 1;
        !example.is_running()
    });
    source.leave();
    example.wait()
}

#[test]
fn every_example_has_a_test() {
    let tests = fs::read_to_string(root().join("tests/tests/system/examples.rs")).unwrap();
    let crates = [root().join("crates")].into_iter();
    let below = |folder: PathBuf| fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let folders = crates.flat_map(below).filter(|path| path.is_dir()).flat_map(|folder| {
        let nested = below(folder.clone()).filter(|path| path.is_dir());
        nested.chain([folder]).collect::<Vec<_>>()
    });
    let mut found = 0;
    for folder in folders.map(|folder| folder.join("examples")).filter(|folder| folder.is_dir()) {
        let known = CRATES.iter().any(|[of, _]| folder == root().join(of).join("examples"));
        assert!(known, "{} is missing in CRATES", folder.display());
        for path in below(folder) {
            let name = path.file_stem().unwrap().to_str().unwrap();
            let called = ["run", "start"].map(|function| format!("{function}(\"{name}\""));
            assert!(called.iter().any(|call| tests.contains(call)), "{name} is not run");
            found += 1;
        }
    }
    assert!(found >= 13, "only {found} examples were found");
}

#[test]
fn an_error_prints_as_a_sentence() {
    let ended = start("controller", ["/nowhere/fleet.toml"]).wait().exits(1);
    let begin = "Error: cannot read the config /nowhere/fleet.toml: ";
    assert!(ended.errors().starts_with(begin), "{}", ended.errors());
}

#[test]
fn a_controller_and_a_planner_meet_in_a_worker_that_is_killed_and_restarted() {
    let arena = Arena::new(&Setup::simulated());
    let config = arena.config();
    let mut worker = arena.worker();
    let mut controller = start("controller", [&config]);
    let (mut planner, mut read) = (start("planner", [&config]), 0);
    let tick = |line: &str| line.starts_with("tick ") && line.contains("robot 7");
    until(&planner, &mut read, tick);
    worker.kill();
    until(&planner, &mut read, |line| line.starts_with("the worker is gone ("));
    let _worker = arena.worker();
    until(&planner, &mut read, tick);
    let frames = run("planner", [config.as_os_str(), "60".as_ref()]);
    assert_eq!(frames.iter().filter(|line| line.starts_with("tick ")).count(), 60, "{frames:#?}");
    planner.kill();
    controller.kill();
    assert_eq!(run("controller", [config.as_os_str(), "3".as_ref()]), ["60 samples sent"]);
}

#[test]
fn an_event_loop_gets_frames_and_the_end_of_a_killed_worker() {
    let arena = Arena::new(&Setup::simulated());
    let config = arena.config();
    let mut worker = arena.worker();
    let mut controller = start("controller", [&config]);
    let (mut event_loop, mut read) = (start("event_loop", [&config]), 0);
    until(&event_loop, &mut read, |line| line.ends_with(" frames") && line != "0 frames");
    worker.kill();
    let last = until(&event_loop, &mut read, |line| line.starts_with("the worker is gone ("));
    assert!(!last.ends_with(" 0 frames"), "{last}");
    event_loop.wait().exits(0);
    controller.kill();
    // The next member removes the files of killed ones.
    arena.worker();
}

#[test]
fn budgets() {
    let arena = Arena::new(&with_batteries());
    let _worker = arena.worker();
    let example = start("budgets", [arena.config().as_os_str(), "20".as_ref()]);
    let frame = |seq, period_ns| {
        let mut samples = [0, 1, 2].map(|robot| sample(robot, seq, period_ns));
        // Its power monitor does not respond.
        let silent = &mut samples[2];
        *silent = Sample::new(2, seq, silent.stamp_ns).command(0.2, 0.0);
        samples.to_vec()
    };
    let mut lines = run_beside(&arena, "robots", frame, example).exits(0).stdout;
    lines.sort();
    assert_starts(&lines, &["robot 0: ", "robot 1: ", "robot 2: 0.0 J metered over 0.0 s"]);
}

#[test]
fn alarms() {
    let setup = Setup { more: "stuck_after_s = 1.5\n".to_owned(), ..Setup::simulated() };
    let arena = Arena::new(&setup);
    let _worker = arena.worker();
    let (mut example, mut source) = (start("alarms", [arena.config()]), arena.source("robots"));
    let (mut seq, mut read, mut missing) =
        (0, 0, vec!["robot 1: StuckSensor (", "robot 2 refused: NotFinite"]);
    eventually("both alarms are printed", || {
        let [mut well, mut stuck, mut refused] =
            [0, 1, 2].map(|robot| sample(robot, seq, setup.period_ns()));
        well = well.command(0.1, 0.0);
        stuck = stuck.command(0.1, 0.0).reading(3.7, stuck.stamp_ns);
        refused = refused.reading(f32::NAN, refused.stamp_ns);
        source.send(&[well, stuck, refused]);
        seq += 1;
        for line in example.lines(read, std::time::Duration::ZERO) {
            missing.retain(|start| !line.starts_with(start));
            read += 1;
        }
        missing.is_empty()
    });
    example.kill();
    source.leave();
}

/// The verdict depends on how punctual the machine is: late frames are stale.
#[test]
fn ask_answers_for_every_robot() {
    let arena = Arena::new(&with_batteries());
    let _worker = arena.worker();
    let mut controller = start("controller", [arena.config()]);
    // Until the worker knows the robots.
    eventually("every robot is answered once", || {
        let printed = run("ask", [arena.config()]);
        (0..3).all(|robot| {
            let start = format!("robot {robot}: ");
            printed.iter().filter(|line| line.starts_with(&start)).count() == 1
        })
    });
    controller.kill();
}

#[test]
fn ask_worker_is_answered_and_refused() {
    let arena = Arena::new(&with_batteries());
    let _worker = arena.worker();
    let frame = |seq, period_ns| [0, 1].map(|robot| sample(robot, seq, period_ns)).to_vec();
    // Until the worker knows the robots.
    eventually("both robots are known", || {
        let example = start("ask_worker", [arena.config()]);
        let printed = run_beside(&arena, "robots", frame, example).exits(0).stdout;
        let starts = ["robot 0: ", "robot 1: ", "robot 1: ", "refused (UnknownRobot): "];
        printed.len() == 4 && printed.iter().zip(starts).all(|(line, of)| line.starts_with(of))
    });
}

#[test]
fn mixed_fleet() {
    let lines = run("mixed_fleet", NOTHING);
    let [forecasts @ .., ticks] = &lines[..] else { panic!("no lines") };
    assert_starts(forecasts, &["gternal: 10 robots", "husky: 2 robots, 28", "rover: 1 robots, 3"]);
    assert!(ticks.ends_with(" ticks"), "{ticks}");
}

#[test]
fn rollouts() {
    let lines = run("rollouts", NOTHING);
    assert_starts(&lines, &["gternal-sim was trained on 3.09", "0.05 m/s", "0.15 m/s", "0.00 m/s"]);
    assert!(!lines.concat().contains("NaN"), "{lines:#?}");
}

#[test]
fn training() {
    assert_starts(
        &run("training", NOTHING),
        &["epoch 1", "epoch 2", "epoch 3", "1180 forecasts of held-out robots", "a model file of"],
    );
}

#[test]
fn offline_evaluation() {
    assert_starts(
        &run("offline_evaluation", NOTHING),
        &["simulated/energy_data_trial1", "simulated/energy_data_trial5"],
    );
}

#[test]
fn a_capture_is_read_and_replayed() {
    let arena = Arena::new(&Setup::simulated());
    let (file, _) = without_loss(|attempt| {
        let file = arena.files().join(format!("{attempt}.mcap"));
        let arguments = ["run", "--format", "json", "--record", file.to_str().unwrap()];
        let mut worker = Child::spawn("worker", arena.command(&arguments));
        worker.wait_for_line("ready:");
        arena.simulate(10, 60);
        (file, worker.end())
    });
    let lines = run("read_capture", [&file]);
    assert!(lines.iter().any(|line| line.starts_with("joulebus/t/samples: ")), "{lines:#?}");
    assert!(lines.last().unwrap().contains(" forecasts, "), "{lines:#?}");
    let [line] = &run("replay", [&file])[..] else { panic!("one line") };
    assert!(line.ends_with(" ticks recomputed, 0 values differ"), "{line}");
    assert!(line.starts_with("verified: ") && !line.contains(": 0 of "), "{line}");
    let verified = alone(&["replay", "--verify", file.to_str().unwrap()]).exits(0).json();
    assert!(line.contains(&format!(": {} of ", verified["ticks_verified"])), "{line} {verified}");
}
