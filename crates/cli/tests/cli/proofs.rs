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
    recorder.wait_for_stderr("recording cli into");
    recorder
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
    let ticks = |file: &Path| {
        let info = output([Path::new("info"), file, Path::new("--format=json")]);
        let info = json(&info);
        let channels = info["files"][0]["channels"].as_array().cloned().unwrap_or_default();
        let of_ticks = channels.iter().find(|channel| channel["topic"] == "joulebus/cli/ticks");
        of_ticks.and_then(|channel| channel["messages"].as_u64()).unwrap_or(0)
    };
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

#[test]
fn topics_that_were_not_recorded_are_recomputed_and_not_compared() {
    let fleet = Fleet::new();
    let file = fleet.path("run.mcap");
    let worker = fleet.worker();
    let recorder = recorder(&fleet, &file, "--topics samples ticks state");
    simulate(&fleet);
    assert!(matches!(code(&recorder.end(Signal::TERM)), 0 | 3));
    worker.end(Signal::TERM).exits(0);
    let (code, report) = verify(std::slice::from_ref(&file));
    assert_eq!(code, 3, "{report:#}");
    let is_lossless = report["messages_lost"] == 0 && report["ticks_unverified"] == 0;
    assert!(!is_lossless || report["verdict"] == "not_compared", "{report:#}");
    let forecasts = &report["coverage"][0]["channels"]["forecasts"];
    assert_eq!(forecasts["compared"], 0, "{report:#}");
    assert!(forecasts["recomputed"].as_u64() > Some(10), "{report:#}");
    let text = stdout(&output([Path::new("replay"), Path::new("--verify"), &file]));
    assert!(!is_lossless || text.starts_with("recomputed, not compared: "), "{text}");
    assert_contains(&text, ["not recorded, so not compared: forecasts, diagnostics, budgets"]);
}
