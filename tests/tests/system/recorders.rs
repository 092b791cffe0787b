//! Recording beside a worker and on a signal; playing in a loop and under another name.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use joulebus_capture_format::Reader;
use joulebus_tests::{Arena, Child, Ended, Setup, alone, eventually, program, without_loss};
use joulebus_wire::Samples;
use rustix::process::Signal;

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
fn a_signal_writes_a_snapshot_and_the_recorder_continues() {
    let arena = Arena::new(&Setup::simulated());
    let file = arena.files().join("snapshot.mcap");
    let name = file.to_str().unwrap();
    let options = ["--snapshot", "60", "--no-alarm", "--format", "json"];
    let arguments = [&["record", "-o", name], &options[..]].concat();
    let mut recorder = Child::spawn("recorder", arena.command(&arguments));
    recorder.wait_for_line("recording t into");
    let _worker = arena.worker();
    arena.simulate(ROBOTS, 30);
    assert!(!file.exists(), "written without a request");
    recorder.signal(Signal::USR1);
    eventually("the first snapshot", || {
        Reader::open(&file).is_ok_and(|mut reader| reader.all(|entry| entry.is_ok()))
    });
    assert!(samples(&file) > 0);

    arena.simulate(ROBOTS, 30);
    let second = arena.files().join("snapshot_1.mcap");
    recorder.signal(Signal::USR1);
    eventually("the second snapshot", || second.exists());
    let report = recorder.end();
    assert!(matches!(report.code(), Some(0 | 3)), "{}", report.errors());
    // Messages of the first snapshot are not written again.
    assert!(samples(&second) > 0);
    let frames = |file: &Path| Reader::open(file).unwrap().count();
    assert_eq!(report.json()["messages"], frames(&file) + frames(&second), "{}", report.text());
    let left = fs::read_dir(arena.files()).unwrap().flatten();
    let captures = left.filter(|entry| entry.path().extension().is_some_and(|end| end == "mcap"));
    assert_eq!(captures.count(), 2, "a snapshot was written at the end");
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
