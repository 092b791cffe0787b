//! Sources that publish for the same robots one after the other, under other names.

use rustix::process::Signal;
use serde_json::Value;

use joulebus_testkit::{assert_contains, eventually};

use crate::fleet::{Exits as _, Fleet, Program, code, json, output, stderr, stdout};

/// A simulation of three robots, 30 samples a second of each.
fn source(fleet: &Fleet, name: &str, more: &str) -> Program {
    Program::start(
        fleet.joulebus(&format!(
            "publish sim --robots 3 --rate 30 --format json --name {name} {more}"
        )),
    )
}

/// Samples that the worker has accepted so far.
fn accepted(fleet: &Fleet) -> u64 {
    let shown = fleet.output("watch --once --format json");
    let frame: Value = serde_json::from_slice(&shown.stdout).unwrap_or_default();
    frame["samples_accepted"].as_u64().unwrap_or_default()
}

fn more_are_accepted(fleet: &Fleet) {
    let before = accepted(fleet);
    eventually("more samples are accepted", || accepted(fleet) > before + 10);
}

/// Ends the worker. Returns how many samples it refused as those of a foreign source, and all that
/// it refused.
fn refused(worker: Program) -> (u64, Value) {
    let report = json(&worker.end(Signal::TERM).exits(0));
    let dropped = report["samples_dropped"].clone();
    (dropped["ForeignSource"].as_u64().unwrap_or_default(), dropped)
}

#[test]
fn a_successor_of_a_source_that_has_ended_is_served_from_its_first_frame_and_verified() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let capture = fleet.path("run.mcap");
    let mut record = fleet.joulebus("record");
    record.arg("-o").arg(&capture);
    let mut recorder = Program::start(record);
    recorder.wait_for_stderr("recording cli into");
    for name in ["first", "second", "third"] {
        let source = source(&fleet, name, "");
        more_are_accepted(&fleet);
        source.end(Signal::TERM).exits(0);
    }
    let recorded = recorder.end(Signal::TERM);
    let (_, dropped) = refused(worker);
    assert_eq!(dropped, serde_json::json!({}));
    let verified = output([&"replay".into(), &"--verify".into(), &capture]);
    match code(&recorded) {
        0 => assert_eq!(code(&verified), 0, "{}", stderr(&verified)),
        // One that gets no processor for a quarter of a second loses messages, and reports that.
        code => assert_eq!(code, 3, "{}", stderr(&recorded)),
    }
}

#[test]
fn a_successor_of_a_killed_source_is_served_within_a_few_seconds() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let mut first = source(&fleet, "first", "");
    more_are_accepted(&fleet);
    first.signal(Signal::KILL);
    first.wait();
    let sent = json(&source(&fleet, "second", "--duration 8").wait())["samples_sent"].clone();
    let (foreign, dropped) = refused(worker);
    println!("figure: {foreign} of {sent} samples of the successor were refused");
    // A robot stays its owner's for 30 s otherwise: all of them would be.
    let sent = sent.as_u64().unwrap();
    assert!(foreign < sent * 5 / 8, "{foreign} of {sent}: {dropped}");
}

#[test]
fn a_second_source_is_refused_while_the_first_lives_or_is_stopped_and_takes_over_at_its_end() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let mut first = source(&fleet, "first", "");
    more_are_accepted(&fleet);
    let mut sent = 0;
    for stopped in [false, true] {
        if stopped {
            first.signal(Signal::STOP);
        }
        let ended = source(&fleet, "second", "--duration 3").wait();
        let report = json(&ended);
        sent += report["samples_sent"].as_u64().unwrap();
        // It learns that, why, and what to do.
        let told = report["samples_refused"]["ForeignSource"].as_u64();
        assert!(told.is_some_and(|told| 0 < told && told <= sent), "{report}");
        assert_contains(&stderr(&ended), ["(ForeignSource)", "end one of the two"]);
    }
    first.signal(Signal::CONT);
    more_are_accepted(&fleet);
    // Nothing of it was accepted, and its end has freed no robot of the first.
    let third = source(&fleet, "third", "");
    more_are_accepted(&fleet);
    first.end(Signal::TERM).exits(0);
    more_are_accepted(&fleet);
    let third = json(&third.end(Signal::TERM).exits(0))["samples_sent"].as_u64().unwrap();
    let (foreign, dropped) = refused(worker);
    assert!((sent + 1..sent + third).contains(&foreign), "{foreign}, {sent}, {third}: {dropped}");
}

/// Two controllers run. The longest time without samples is printed for docs/how-to/standby.md.
#[test]
fn a_second_controller_takes_over_when_the_first_is_killed() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let mut first = source(&fleet, "first", "");
    more_are_accepted(&fleet);
    let watch = Program::start(fleet.joulebus("watch --format json"));
    let mut second = source(&fleet, "second", "");
    second.wait_for_stderr("(ForeignSource)");
    first.signal(Signal::KILL);
    first.wait();
    more_are_accepted(&fleet);
    more_are_accepted(&fleet);
    let shown = stdout(&watch.end(Signal::TERM));
    let frames = shown.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let frames: Vec<(u64, u64)> = frames
        .filter_map(|frame| Some((frame["tick"].as_u64()?, frame["samples_accepted"].as_u64()?)))
        .collect();
    let alike = frames.chunk_by(|one, other| one.1 == other.1);
    let gaps = alike.map(|alike| alike[alike.len() - 1].0 - alike[0].0);
    println!("figure: {} ticks without samples", gaps.max().unwrap_or_default());
    second.end(Signal::TERM).exits(0);
    worker.end(Signal::TERM).exits(0);
}

/// The newer process of a name has the robots. The older one learns it.
#[test]
fn a_controller_that_was_replaced_by_a_second_of_its_name_learns_it() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let mut first = source(&fleet, "twin", "");
    more_are_accepted(&fleet);
    let second = source(&fleet, "twin", "");
    first.wait_for_stderr("(OldEpoch)");
    let ended = first.end(Signal::TERM);
    assert_contains(&stderr(&ended), ["a newer process with this source's name has taken over"]);
    second.end(Signal::TERM).exits(0);
    worker.end(Signal::TERM).exits(0);
}
