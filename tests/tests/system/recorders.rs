//! A worker that records itself; playing in a loop and under another name.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use joulebus_capture_format::Reader;
use joulebus_tests::{Arena, Child, Ended, Setup, alone, program, without_loss};
use joulebus_wire::Samples;

const ROBOTS: u32 = 12;

/// Number of samples in a capture.
fn samples(file: &Path) -> u64 {
    let messages = Reader::open(file).unwrap().map(|entry| entry.unwrap().message);
    messages
        .filter_map(|message| message.into_frame::<Samples>().ok())
        .map(|frame| frame.rows.len() as u64)
        .sum()
}

/// A worker that records itself while robots are simulated; returns the capture and the worker's
/// exit.
fn recorded(arena: &Arena, name: &str) -> (PathBuf, Ended) {
    without_loss(|attempt| {
        let file = arena.files().join(format!("{attempt}-{name}"));
        let arguments = ["run", "--format", "json", "--record", file.to_str().unwrap()];
        let mut worker = Child::spawn("worker", arena.command(&arguments));
        worker.wait_for_line("ready:");
        arena.simulate(ROBOTS, 60);
        (file, worker.end())
    })
}

#[test]
fn a_capture_of_a_worker_that_records_itself_is_verified() {
    let arena = Arena::new(&Setup::simulated());
    let (file, ended) = recorded(&arena, "beside.mcap");
    let report = ended.json();
    assert_eq!(report["samples_accepted"], samples(&file), "{report}");
    let verified = alone(&["replay", "--verify", file.to_str().unwrap()]);
    assert_eq!(verified.code(), Some(0), "{}", verified.text());
    let verified = verified.json();
    assert_eq!(verified["ticks_verified"], report["ticks"], "{verified}");
}

#[test]
fn all_samples_of_a_looped_replay_are_accepted() {
    let arena = Arena::new(&Setup::simulated());
    let (file, _) = recorded(&arena, "loop.mcap");
    let once = samples(&file);
    let mut worker = arena.worker();
    let played = alone(&["replay", file.to_str().unwrap(), "--loop=3", "--rate", "max"]);
    let report = played.json();
    assert_eq!(played.code(), Some(0), "{report} {}", played.errors());
    assert_eq!(report["samples"], 3 * once, "{report}");
    let report = worker.stop().json();
    assert_eq!(report["samples_accepted"], 3 * once, "{report}");
}

#[test]
fn a_capture_is_played_under_another_name() {
    let arena = Arena::new(&Setup::simulated());
    let (file, _) = recorded(&arena, "named.mcap");
    let text = fs::read_to_string(arena.config()).unwrap();
    let renamed = text.replace("name = \"t\"", "name = \"copy\"");
    assert_ne!(text, renamed);
    let config = arena.files().join("copy.toml");
    fs::write(&config, renamed).unwrap();
    let mut command = Command::new(program("joulebus-under-test"));
    command.args(["run", "--format", "json", "--config"]).arg(config);
    let mut worker = Child::spawn("the copy's worker", command);
    worker.wait_for_line("ready:");
    alone(&["replay", file.to_str().unwrap(), "--remap", "t:=copy", "--rate", "max"]).exits(0);
    let report = worker.stop().json();
    assert_eq!(report["samples_accepted"], samples(&file), "{report}");
    let wrong = alone(&["replay", file.to_str().unwrap(), "--remap", "t=copy"]);
    assert_eq!(wrong.code(), Some(2));
    assert!(wrong.errors().contains(":="), "{}", wrong.errors());
}
