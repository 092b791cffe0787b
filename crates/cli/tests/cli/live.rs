//! A worker with sources.

use std::fs;

use joulebus_testkit::{assert_contains, eventually};
use rustix::process::Signal;

use crate::fleet::{Exits as _, Fleet, Program, at, code, json, stderr};

#[test]
fn every_sample_played_as_fast_as_possible_is_accepted() {
    let fleet = Fleet::new();
    let (rows, robots, passes) = (200, 4, 2);
    let files: Vec<_> =
        (0..robots).map(|robot| at(&fleet.recording(&format!("{robot}.csv"), rows), "3")).collect();
    let worker = fleet.worker();
    let mut play = fleet.joulebus("publish trial --rate max --loop=2 --format json");
    let played = play.args(&files).output().unwrap().exits(0);
    let played = json(&played);
    let sent = u64::from(rows * robots * passes);
    assert_eq!(played["samples_sent"], sent);
    assert_eq!(played["robots"], robots);
    for (place, trial) in played["trials"].as_array().unwrap().iter().enumerate() {
        assert_eq!(trial["robot"], 3 + place);
        assert_eq!(trial["samples"], rows * passes);
    }
    let speed = played["speed"].as_f64().unwrap();
    assert!(speed.is_finite() && speed > 0.0, "{speed}");
    println!("figure: {sent} samples played at {speed:.1} times their speed");

    let worker = worker.end(Signal::TERM).exits(0);
    let report = json(&worker);
    assert_eq!(report["samples_accepted"], sent, "{report}");
    assert_eq!(report["samples_dropped"], serde_json::json!({}), "{report}");
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_file_gets_the_robot_or_platform_after_its_at_sign() {
    let fleet = Fleet::new();
    fs::create_dir(fleet.path("rovers")).unwrap();
    let rovers = [fleet.recording("rovers/b.csv", 20), fleet.recording("rovers/a.csv", 20)];
    fs::write(fleet.path("rovers/notes.txt"), "no recording").unwrap();
    let one = fleet.recording("one.csv", 20);
    let mut play = fleet.joulebus("publish trial --no-wait --rate 1000 --format json");
    play.arg(format!("{}@7", one.display()));
    play.arg(format!("{}@rover", fleet.path("rovers").display()));
    let played = play.output().unwrap().exits(0);
    assert_contains(&stderr(&played), ["no worker serves fleet cli"]);
    let played = json(&played);
    let trial = |robot: u32, file: &std::path::Path| (robot, file.display().to_string());
    let found: Vec<_> = played["trials"]
        .as_array()
        .unwrap()
        .iter()
        .map(|trial| {
            let robot = u32::try_from(trial["robot"].as_u64().unwrap()).unwrap();
            (robot, trial["file"].as_str().unwrap().to_owned())
        })
        .collect();
    let expected = [trial(7, &one), trial(100, &rovers[1]), trial(101, &rovers[0])];
    assert_eq!(found, expected);
    assert_eq!(played["frames_unheard"], played["frames_sent"]);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_trial_waits_for_the_worker_and_loses_nothing() {
    let fleet = Fleet::new();
    let file = fleet.recording("a.csv", 60);
    let mut play = fleet.joulebus("publish trial --rate 4 --format json");
    play.arg(at(&file, "0"));
    let mut play = Program::start(play);
    play.wait_for_stderr("Waiting for one");
    let worker = fleet.worker();
    let played = play.wait().exits(0);
    assert_eq!(json(&played)["samples_sent"], 60);
    let report = json(&worker.end(Signal::INT));
    assert_eq!(report["samples_accepted"], 60, "{report}");
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_killed_worker_loses_at_most_the_window_of_a_fast_source() {
    assert_lost_at_most_the_window(false);
}

#[test]
fn a_worker_killed_and_removed_while_a_fast_source_is_paused_costs_at_most_the_window() {
    assert_lost_at_most_the_window(true);
}

/// Kills the worker of a fast source. The source may be paused until the worker's files have been
/// removed: then its frames have no reader at all.
fn assert_lost_at_most_the_window(is_paused: bool) {
    let fleet = Fleet::new();
    // Long enough that it has not ended when its worker does.
    let file = fleet.recording("a.csv", 3_000);
    let worker = fleet.worker();
    let mut play = fleet.joulebus("publish trial --rate max --window 3 --format json");
    play.arg(at(&file, "0"));
    let mut play = Program::start(play);
    // Each attempt has a timeout of three seconds.
    eventually("a robot has sent samples", || code(&fleet.output("watch --once")) == 0);
    if is_paused {
        play.signal(Signal::STOP);
    }
    let killed = worker.end(Signal::KILL);
    assert_eq!(killed.status.code(), None);
    if is_paused {
        // Its exit code shows that no worker runs.
        let removed = fleet.output("doctor --fix");
        assert!(code(&removed) < 2, "{}", stderr(&removed));
        play.signal(Signal::CONT);
    }
    play.wait_for_stderr("Waiting for one");
    let worker = fleet.worker();
    let played = play.wait();
    let report = json(&played);
    let lost =
        report["frames_unanswered"].as_u64().unwrap() + report["frames_unheard"].as_u64().unwrap();
    assert!(lost <= 4, "{report}");
    assert_eq!(code(&played), if report["frames_unanswered"] == 0 { 0 } else { 3 }, "{report}");
    assert_eq!(report["samples_sent"], 3_000);
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    assert_eq!(fleet.stale_files(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn all_samples_of_a_simulated_fleet_are_accepted() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let sim =
        fleet.output("publish sim --robots 5 --duration 1.5 --fault 2=load:1.5@0.5 --format json");
    assert_eq!(code(&sim), 0, "{}", stderr(&sim));
    let sim = json(&sim);
    let (frames, skipped) = (&sim["frames_sent"], &sim["ticks_skipped"]);
    let places = frames.as_u64().unwrap() + skipped.as_u64().unwrap();
    // More than 45 only if the last one was late.
    let duration_s = sim["duration_s"].as_f64().unwrap();
    assert!(places >= 45 && places as f64 <= 45.0_f64.max(30.0 * duration_s), "{sim}");
    assert_eq!(sim["samples_sent"].as_u64().unwrap(), 5 * frames.as_u64().unwrap());
    let report = json(&worker.end(Signal::TERM));
    let dropped = report["samples_dropped"].as_object().unwrap().values();
    let dropped: u64 = dropped.map(|count| count.as_u64().unwrap()).sum();
    let accepted = report["samples_accepted"].as_u64().unwrap();
    assert_eq!(accepted + dropped, sim["samples_sent"].as_u64().unwrap(), "{report}");
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_signal_ends_a_source_cleanly() {
    for (verb, signal) in [
        ("publish sim --robots 3 --format json", Signal::INT),
        ("publish trial --loop --no-wait --format json", Signal::TERM),
        // Still waiting for a worker.
        ("publish trial --loop --format json", Signal::TERM),
    ] {
        let fleet = Fleet::new();
        let mut source = fleet.joulebus(verb);
        if verb.contains("trial") {
            source.arg(at(&fleet.recording("a.csv", 30), "0"));
        }
        let mut source = Program::start(source);
        source.wait_for_stderr("no worker serves fleet cli");
        let ended = source.end(signal);
        assert_eq!(code(&ended), 0, "{verb}: {}", stderr(&ended));
        assert_eq!(json(&ended)["fleet"], "cli", "{verb}");
        assert!(fleet.stale_files().is_empty(), "{verb}");
    }
}
