//! Every example succeeds and prints what it documents. Cargo builds examples before the tests of
//! their package, unless a single test is selected: `cargo test -p joulebus-examples`.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use joulebus_examples::PrivateFleet;

fn program(name: &str) -> PathBuf {
    let tests = std::env::current_exe().unwrap();
    let profile = tests.parent().and_then(Path::parent).unwrap();
    let program = profile.join("examples").join(name);
    assert!(
        program.exists(),
        "{} is not built: run `cargo test -p joulebus-examples` without `--test`",
        program.display()
    );
    program
}

fn start(name: &str, arguments: &[&Path]) -> Child {
    let mut command = Command::new(program(name));
    command.args(arguments);
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

/// The lines that an example prints until it exits successfully.
fn lines(example: Child) -> Vec<String> {
    printed(example.wait_with_output().unwrap())
}

fn printed(output: Output) -> Vec<String> {
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success(),
        "{}; output:\n{printed}{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    printed.lines().map(str::to_owned).collect()
}

/// Same as [`lines`], of an example that reports `late` if a thread gets no processor in time, and
/// is run again then.
fn in_time(late: &str, start: impl Fn() -> Child) -> Vec<String> {
    for _ in 0..5 {
        let output = start().wait_with_output().unwrap();
        let is_late = |text: &[u8]| String::from_utf8_lossy(text).contains(late);
        if !is_late(&output.stdout) && !is_late(&output.stderr) {
            return printed(output);
        }
    }
    panic!("each time: {late}");
}

/// Same as [`lines`], of an example that records.
fn recorded(start: impl Fn() -> Child) -> Vec<String> {
    in_time("the recorder lost ", start)
}

fn run(name: &str) -> Vec<String> {
    lines(start(name, &[]))
}

#[track_caller]
fn assert_starts(lines: &[String], starts: &[&str]) {
    assert_eq!(lines.len(), starts.len(), "{lines:#?}");
    for (line, start) in lines.iter().zip(starts) {
        assert!(line.starts_with(start), "{line:?} does not begin with {start:?}");
    }
}

/// The verdict depends on how punctual the machine is: late frames are stale.
#[test]
fn ask_answers_for_every_robot() {
    let printed = run("ask");
    for robot in 0..3 {
        let start = format!("robot {robot}: ");
        let answers = printed.iter().filter(|line| line.starts_with(&start)).count();
        assert_eq!(answers, 1, "{printed:#?}");
    }
}

#[test]
fn ask_worker_is_answered_and_refused() {
    let printed = in_time("it is just starting", || start("ask_worker", &[]));
    assert_eq!(printed.len(), 5, "{printed:#?}");
    assert_eq!(printed[2].split(':').next(), Some("robot 1"), "{printed:#?}");
    assert_eq!(printed[3].split(':').next(), Some("refused (UnknownRobot)"));
    assert_eq!(printed[4], "2 questions answered");
}

#[test]
fn an_error_prints_as_a_sentence() {
    let nowhere = Path::new("/nowhere/fleet.toml");
    let output = start("controller", &[nowhere]).wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let printed = String::from_utf8(output.stderr).unwrap();
    let begin = "Error: cannot read the config /nowhere/fleet.toml: ";
    assert!(printed.starts_with(begin), "{printed}");
}

#[test]
fn every_example_has_a_test() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let tests = fs::read_to_string(here.join("tests/run.rs")).unwrap();
    let manifest = fs::read_to_string(here.join("Cargo.toml")).unwrap();
    for file in fs::read_dir(here).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "rs") {
            let name = path.file_stem().unwrap().to_str().unwrap();
            let called = ["run", "start"].map(|function| format!("{function}(\"{name}\""));
            assert!(called.iter().any(|call| tests.contains(call)), "{name} is not run");
            assert!(manifest.contains(&format!("name = \"{name}\"")), "{name} is not built");
        }
    }
}

#[test]
fn a_controller_and_a_planner_meet_in_a_worker() {
    let fleet = PrivateFleet::with_worker(
        "[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-19\"]\n",
    )
    .unwrap();
    let planner = start("planner", &[fleet.config(), "60".as_ref()]);
    let controller = start("controller", &[fleet.config(), "90".as_ref()]);
    assert_eq!(lines(controller), ["1800 samples sent"]);
    let printed_lines = lines(planner);
    let frames = printed_lines.iter().filter(|line| line.starts_with("tick "));
    assert_eq!(frames.count(), 60, "{printed_lines:#?}");
}

#[test]
fn budgets() {
    assert_starts(
        &run("budgets"),
        &["robot 0: ", "robot 1: ", "robot 2: 0.0 J metered over 0.0 s"],
    );
}

#[test]
fn alarms() {
    assert_starts(&run("alarms"), &["robot 2 refused: Some(NotFinite)", "robot 1: StuckSensor"]);
}

#[test]
fn worker_death() {
    assert_starts(&run("worker_death"), &["tick ", "the worker is gone", "tick "]);
}

#[test]
fn an_event_loop_gets_frames_and_the_end_of_a_killed_worker() {
    let fleet = PrivateFleet::new("[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n");
    let fleet = fleet.unwrap();
    // With a config, that example is a worker.
    let mut worker = start("worker_death", &[fleet.config()]);
    let mut event_loop = start("event_loop", &[fleet.config()]);
    let mut lines = BufReader::new(event_loop.stdout.take().unwrap()).lines();
    let mut line = || lines.next().unwrap().unwrap();
    while line() == "0 frames" {}
    worker.kill().unwrap();
    worker.wait().unwrap();
    let last = loop {
        let line = line();
        if line.starts_with("the worker is gone (") {
            break line;
        }
    };
    assert!(!last.ends_with(" 0 frames"), "{last}");
    assert!(event_loop.wait().unwrap().success());
}

#[test]
fn mixed_fleet() {
    assert_starts(
        &run("mixed_fleet"),
        &["gternal: 10 robots", "husky: 2 robots, 28", "rover: 1 robots, 3"],
    );
}

#[test]
fn rollouts() {
    let lines = run("rollouts");
    assert_starts(&lines, &["gternal-sim was trained on 3.09", "0.05 m/s", "0.15 m/s", "0.00 m/s"]);
    assert!(!lines.concat().contains("NaN"), "{lines:#?}");
}

#[test]
fn training() {
    assert_starts(
        &run("training"),
        &["epoch 1", "epoch 2", "epoch 3", "1180 forecasts of held-out robots", "a model file of"],
    );
}

#[test]
fn offline_evaluation() {
    assert_starts(
        &run("offline_evaluation"),
        &["simulated/energy_data_trial1", "simulated/energy_data_trial5"],
    );
}

#[test]
fn read_capture() {
    let lines = recorded(|| start("read_capture", &[]));
    assert!(lines.iter().any(|line| line == "joulebus/example/samples: 60 messages"), "{lines:#?}");
    assert!(lines.last().unwrap().contains(" forecasts, "), "{lines:#?}");
}

#[test]
fn replay() {
    let [line] = &recorded(|| start("replay", &[]))[..] else { panic!("one line") };
    assert!(line.ends_with(" ticks recomputed, 0 values differ"), "{line}");
    assert!(line.starts_with("verified: ") && !line.contains(": 0 of "), "{line}");
}
