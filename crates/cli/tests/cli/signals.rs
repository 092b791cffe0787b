//! Signals that end a subcommand: each ends it cleanly and leaves no files.

use std::path::PathBuf;
use std::process::Command;

use joulebus_test_processes::{end_signals, eventually, ignores_hangup};
use rustix::process::Signal;

use crate::captures::capture;
use crate::fleet::{Fleet, Program, code, joulebus, json, stderr};

/// Subcommands that run until stopped, and the text they print once running.
const VERBS: [(&str, &str); 10] = [
    ("run", "ready:"),
    ("run --record FILE", "ready:"),
    ("record -o FILE", "recording cli into"),
    ("record --snapshot 5 -o FILE", "recording cli into"),
    ("publish sim --robots 3", "no worker runs"),
    (
        "publish trial TRIAL --loop --no-wait --first-robot 0",
        "no worker runs",
    ),
    ("publish trial TRIAL --first-robot 0", "waiting for one"),
    ("watch --plain", "waiting for a worker"),
    ("watch --format json", "waiting for a worker"),
    ("replay CAPTURE", "waiting for one"),
];

/// The command of a subcommand, with its input files created.
fn command(fleet: &Fleet, verb: &str) -> Command {
    let file = |name: &str| -> PathBuf {
        match name {
            "FILE" => fleet.path("run.mcap"),
            "TRIAL" => fleet.recording("a.csv", 30),
            "CAPTURE" => capture(fleet, 300).0,
            word => PathBuf::from(word),
        }
    };
    let mut command = joulebus(verb.split_whitespace().map(file));
    command.arg("--config").arg(fleet.config());
    command
}

#[test]
fn every_verb_ends_cleanly_at_a_signal_and_when_its_terminal_is_closed() {
    for (verb, says) in VERBS {
        for signal in end_signals() {
            let fleet = Fleet::new();
            let mut program = Program::start(command(&fleet, verb));
            program.wait_for_stderr(says);
            let ended = program.end(signal);
            assert_eq!(code(&ended), 0, "{verb}, {signal:?}: {}", stderr(&ended));
            assert!(fleet.stale_files().is_empty(), "{verb}, {signal:?}");
        }
    }
}

#[test]
fn a_process_started_with_nohup_outlives_its_terminal() {
    let fleet = Fleet::new();
    let run = fleet.joulebus("run");
    let mut nohup = Command::new("bash");
    nohup.args(["-c", "trap '' HUP; exec \"$@\"", "bash"]);
    nohup.arg(run.get_program()).args(run.get_args());
    let mut worker = Program::start(nohup);
    worker.wait_for_stderr("ready:");
    assert!(ignores_hangup(worker.pid()));
    worker.signal(Signal::HUP);
    let doctor = json(&fleet.output("doctor --format json"));
    let runs = format!("runs, pid {}", worker.pid());
    assert!(doctor["checks"].to_string().contains(&runs), "{doctor}");
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_snapshot_requested_together_with_the_end_is_written() {
    let fleet = Fleet::new();
    let file = fleet.path("asked.mcap");
    let worker = fleet.worker();
    let verb = format!(
        "record --snapshot 60 --no-alarm --format json -o {}",
        file.display()
    );
    let mut record = Program::start(fleet.joulebus(&verb));
    record.wait_for_stderr("recording cli into");
    let sent = fleet.output("publish sim --robots 3 --duration 0.5 --format json");
    assert_eq!(code(&sent), 0, "{}", stderr(&sent));
    eventually("messages in memory", || {
        // Progress is printed every five seconds.
        record
            .said()
            .iter()
            .any(|line| line.contains("in memory") && !line.contains(" 0 messages of"))
    });
    record.signal(Signal::USR1);
    let ended = record.end(Signal::TERM);
    assert_eq!(code(&ended), 0, "{}", stderr(&ended));
    let report = json(&ended);
    assert_eq!(report["files"].as_array().unwrap().len(), 1, "{report}");
    assert!(report["messages"].as_u64().unwrap() > 0, "{report}");
    assert!(file.exists());
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    assert!(fleet.stale_files().is_empty());
}
