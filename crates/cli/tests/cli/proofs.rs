//! `replay --verify` of recordings of real processes: exit 0 means that all was compared.

use std::path::{Path, PathBuf};
use std::process::Output;

use joulebus_testkit::{assert_contains, eventually};
use rustix::process::Signal;
use serde_json::Value;

use crate::fleet::{Exits as _, Fleet, Program, code, json, output, stderr, stdout};

fn recorder(fleet: &Fleet, file: &Path, options: &str) -> Program {
    let mut record = fleet.joulebus(&format!("record --format json {options}"));
    record.arg("-o").arg(file);
    let mut recorder = Program::start(record);
    recorder.wait_for_stderr("recording ");
    recorder
}

/// Number of messages of a topic that a capture has so far.
fn messages(file: &Path, topic: &str) -> u64 {
    let info = output([Path::new("info"), file, Path::new("--format=json")]);
    let info = json(&info);
    let channels = info["files"][0]["channels"].as_array().cloned().unwrap_or_default();
    let topic = format!("joulebus/cli/{topic}");
    let of_topic = channels.iter().find(|channel| channel["topic"] == topic);
    of_topic.and_then(|channel| channel["messages"].as_u64()).unwrap_or(0)
}

fn simulate(fleet: &Fleet) {
    fleet.output("publish sim --robots 2 --duration 2").exits(0);
}

/// The exit code of a verification, and its report. Each frame that was sent is compared, or has a
/// reason, and exit 0 means that no reason is missing.
fn verify(files: &[PathBuf]) -> (i32, Value) {
    let words = ["replay", "--verify", "--format", "json"].map(PathBuf::from);
    let verified = output(words.iter().chain(files));
    let (code, report) = (code(&verified), json(&verified));
    assert_eq!(code == 0, report["verdict"] == "verified", "{report}");
    let sum = |reasons: &Value| -> u64 {
        let reasons = reasons.as_object().unwrap().values();
        reasons.map(|count| count.as_u64().unwrap()).sum()
    };
    for run in report["coverage"].as_array().unwrap() {
        for (name, channel) in run["channels"].as_object().unwrap() {
            let (compared, missing) = (&channel["compared"], sum(&channel["missing"]));
            let accounted = compared.as_u64().unwrap() + sum(&channel["excused"]) + missing;
            assert_eq!(channel["sent"], accounted, "{name}: {report}");
            assert!(code != 0 || missing == 0 || name == "state", "{name}: {report}");
        }
    }
    (code, report)
}

/// A recording that lost nothing is verified. On a busy host a recorder may lose messages, which it
/// reports.
fn assert_verified(recorded: &Output, files: &[PathBuf]) -> Value {
    let (code, report) = verify(files);
    assert_eq!(report["differences"], 0, "{report:#}");
    match recorded.status.code() {
        Some(0) => assert_eq!(code, 0, "{report:#}"),
        Some(3) => println!("the recorder lost messages: {}", stdout(recorded)),
        _ => panic!("{recorded:?}"),
    }
    report
}

#[test]
fn a_recording_with_a_killed_worker_in_parts_is_verified_and_in_another_order_refused() {
    let fleet = Fleet::new();
    let file = fleet.path("run.mcap");
    let worker = fleet.worker();
    let recorder = recorder(&fleet, &file, "--max-bag-duration 2");
    simulate(&fleet);
    let _ = worker.end(Signal::KILL);
    let worker = fleet.worker();
    simulate(&fleet);
    let recorded = recorder.end(Signal::TERM);
    worker.end(Signal::TERM).exits(0);
    let parts = (0..).map(|part| match part {
        0 => file.clone(),
        part => fleet.path(&format!("run_{part}.mcap")),
    });
    let parts: Vec<PathBuf> = parts.take_while(|part| part.exists()).collect();
    assert!(parts.len() > 1, "{parts:?}");
    let report = assert_verified(&recorded, &parts);
    assert_eq!(report["runs"], 2, "{report:#}");
    assert!(report["keyframes"].as_u64() >= Some(2), "{report:#}");
    assert_eq!(report["left_out"], Value::Array(Vec::new()), "{report:#}");
    let words = ["replay", "--verify", "--playback-duration", "1"].map(PathBuf::from);
    let part = output(words.iter().chain(&parts));
    assert_contains(&stdout(&part), ["only the part that", "--playback-duration"]);
    let reversed: Vec<PathBuf> = parts.iter().rev().cloned().collect();
    let words = ["replay", "--verify"].map(PathBuf::from);
    let refused = output(words.iter().chain(&reversed)).exits(2);
    let in_order: Vec<String> = parts.iter().map(|part| part.display().to_string()).collect();
    assert_contains(&stderr(&refused), ["not in the order", &in_order.join(" ")]);
}

#[test]
fn ticks_between_two_recordings_are_absent_and_a_snapshot_is_verified() {
    let fleet = Fleet::new();
    let file = fleet.path("run.mcap");
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 2"));
    let snapshot = fleet.path("snapshot.mcap");
    let mut keeps = recorder(&fleet, &snapshot, "--snapshot 60 --no-alarm");
    let first = recorder(&fleet, &file, "");
    let ticks = |file: &Path| messages(file, "ticks");
    eventually("a part with ticks", || ticks(&file) > 30);
    let ended = first.end(Signal::TERM);
    let more = recorder(&fleet, &fleet.path("unused.mcap"), "");
    eventually("ticks between", || ticks(&fleet.path("unused.mcap")) > 10);
    assert!(matches!(code(&more.end(Signal::TERM)), 0 | 3));
    let second = recorder(&fleet, &file, "--resume");
    let resumed = fleet.path("run_1.mcap");
    eventually("a second part with ticks", || resumed.exists() && ticks(&resumed) > 30);
    assert!(matches!(code(&second.end(Signal::TERM)), 0 | 3));
    keeps.signal(Signal::USR1);
    eventually("a snapshot", || snapshot.exists());
    let kept = keeps.end(Signal::TERM);
    source.end(Signal::TERM);
    worker.end(Signal::TERM).exits(0);

    assert_verified(&ended, std::slice::from_ref(&file));
    assert_verified(&kept, &[snapshot]);
    let (code, report) = verify(&[file, resumed]);
    assert_eq!((code, &report["verdict"]), (3, &"incomplete".into()), "{report:#}");
    assert!(report["ticks_absent"].as_u64() > Some(10), "{report:#}");
    assert_eq!((&report["differences"], &report["runs"]), (&0.into(), &1.into()), "{report:#}");
}

/// The worker sends outlooks while somebody reads them, which a recorder of these topics does not.
#[test]
fn channels_on_demand_are_only_missed_in_ticks_in_which_somebody_read_them() {
    const TOPICS: &str = "--topics samples forecasts diagnostics budgets plan_states ticks state";
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 2"));
    let files = ["alone.mcap", "read.mcap", "all.mcap"].map(|name| fleet.path(name));
    let more = |file: &Path| {
        let before = messages(file, "ticks");
        eventually("more ticks", || messages(file, "ticks") > before + 20);
    };
    let alone = recorder(&fleet, &files[0], TOPICS);
    more(&files[0]);
    let alone = alone.end(Signal::TERM);
    let beside = recorder(&fleet, &files[1], TOPICS);
    more(&files[1]);
    // It reads all channels, and goes.
    let all = recorder(&fleet, &files[2], "--per-robot");
    more(&files[2]);
    let all = all.end(Signal::TERM);
    more(&files[1]);
    let beside = beside.end(Signal::TERM);
    source.end(Signal::TERM);
    worker.end(Signal::TERM).exits(0);
    assert_verified(&alone, &files[..1]);
    assert_verified(&all, &files[2..]);
    assert!(matches!(code(&beside), 0 | 3));
    let (code, report) = verify(&files[1..2]);
    let channels = &report["coverage"][0]["channels"];
    let sent = |name: &str| channels[name]["sent"].as_u64().unwrap();
    assert_eq!((code, &report["differences"]), (3, &0.into()), "{report:#}");
    assert!((1..sent("forecasts")).contains(&sent("outlooks")), "{channels:#}");
    assert_eq!(report["not_recorded"], serde_json::json!(["outlooks"]), "{report:#}");
}

#[test]
fn a_worker_that_is_stopped_for_a_while_and_one_that_is_started_again_are_verified() {
    let fleet = Fleet::new();
    let file = fleet.path("run.mcap");
    let mut worker = fleet.worker();
    let recorder = recorder(&fleet, &file, "");
    let source = Program::start(fleet.joulebus("publish sim --robots 2"));
    let ticks = || messages(&file, "ticks");
    let more = |what: &str| {
        let before = ticks();
        eventually(what, || ticks() > before + 30);
    };
    more("ticks before the stop");
    worker.signal(Signal::STOP);
    std::thread::sleep(std::time::Duration::from_millis(1_500));
    worker.signal(Signal::CONT);
    more("ticks after the stop");
    worker.end(Signal::TERM).exits(0);
    let worker = fleet.worker();
    more("ticks of the second worker");
    let recorded = recorder.end(Signal::TERM);
    source.end(Signal::TERM);
    worker.end(Signal::TERM).exits(0);
    let report = assert_verified(&recorded, std::slice::from_ref(&file));
    assert_eq!(report["runs"], 2, "{report:#}");
}

#[test]
fn files_of_another_fleet_are_named_whatever_their_order() {
    let fleets = ["cli", "yard"].map(Fleet::named);
    let both = fleets[0].path("both.mcap");
    let more = format!("--config {}", fleets[1].config().display());
    let workers = [0, 1].map(|at: usize| fleets[at].worker());
    let of_both = recorder(&fleets[0], &both, &more);
    // One after the other, so that they have an order.
    let files = fleets.each_ref().map(|fleet| {
        let file = fleet.path("run.mcap");
        let recorder = recorder(fleet, &file, "");
        simulate(fleet);
        assert!(matches!(code(&recorder.end(Signal::TERM)), 0 | 3));
        file
    });
    assert!(matches!(code(&of_both.end(Signal::TERM)), 0 | 3));
    for worker in workers {
        worker.end(Signal::TERM).exits(0);
    }
    let verified = |words: &str| {
        let words = format!("replay --verify --format json {words}");
        output(words.split_whitespace().map(Path::new).chain([&*both]))
    };
    assert_contains(&stderr(&verified("").exits(2)), ["several fleets: choose with --fleet"]);
    let report = json(&verified("--fleet yard"));
    assert_eq!((&report["fleet"], &report["differences"]), (&"yard".into(), &0.into()));
    let left_out = report["left_out"][0].as_str().unwrap();
    assert_contains(left_out, ["messages of fleet cli are left out: choose it with --fleet cli"]);

    let (_, alone) = verify(&files[..1]);
    // The one that was recorded later comes first, and last.
    for (given, fleet, other) in [([0, 1], "cli", "yard"), ([1, 0], "yard", "cli")] {
        let given = given.map(|at: usize| files[at].clone());
        let (code, report) = verify(&given);
        let what =
            format!("{}: is of fleet {other:?}, and has nothing of {fleet:?}", given[1].display());
        assert_eq!((code, &report["fleet"]), (3, &fleet.into()), "{report:#}");
        assert_eq!(report["damages"], serde_json::json!([what]), "{report:#}");
        assert_eq!(report["differences"], 0, "{report:#}");
        if fleet == "cli" {
            assert_eq!(report["coverage"], alone["coverage"]);
        }
        let left_out = report["left_out"][0].as_str().unwrap();
        let advice = format!("messages of fleet {other} are left out: give its files alone");
        assert_contains(left_out, [&*advice]);
        let words = ["replay", "--verify", "--fleet", other].map(PathBuf::from);
        let refused = output(words.iter().chain(&given)).exits(2);
        let what = format!("contains no fleet {other:?}, its fleets: {fleet}");
        assert_contains(&stderr(&refused), [&*what]);
    }
}
