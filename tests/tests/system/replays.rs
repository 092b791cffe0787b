//! A recording of real processes is verified bit by bit, played back into shared memory, and gives
//! the same bits there. That each flipped bit is named, and what another model makes of a recording,
//! is tested in `capture-verify`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use joulebus_capture_format::{Entry, Frame, Message, Reader};
use joulebus_testkit::assert_contains;
use joulebus_tests::{
    Arena, Child, Ended, ReaderLine, Setup, alone, eventually, program, without_loss,
};
use joulebus_wire::{
    Budgets, Channel, Diagnostic, Diagnostics, Forecast, Forecasts, Quality, Sample, Samples,
    sample_flag,
};
use serde_json::Value;

const ROBOTS: u32 = 12;

fn entries(file: &Path) -> Vec<Entry> {
    Reader::open(file).unwrap().map(Result::unwrap).collect()
}

/// Samples and the answers to each, by robot and number.
#[derive(Default)]
struct Exchange {
    samples: BTreeMap<(u32, u64), Sample>,
    forecasts: BTreeMap<(u32, u64), Forecast>,
    diagnostics: BTreeMap<(u32, u64), Diagnostic>,
}

/// The rows of a frame; none of another channel's.
fn rows_of<C: Channel>(message: &Message) -> impl Iterator<Item = C::Row> {
    let frames = message.frame::<C>().into_iter();
    frames.flat_map(|frame| frame.rows.iter().copied())
}

fn exchange(file: &Path) -> Exchange {
    let mut exchange = Exchange::default();
    for entry in entries(file) {
        let message = &entry.message;
        let samples = rows_of::<Samples>(message).map(|row| ((row.robot, row.seq), row));
        exchange.samples.extend(samples);
        // Open-loop forecasts by the worker's clock are provisional.
        let live = rows_of::<Forecasts>(message).filter(|row| {
            matches!(row.quality(), Quality::Fresh | Quality::Held | Quality::Warmup { .. })
        });
        exchange.forecasts.extend(live.map(|row| ((row.robot, row.sample_seq), row)));
        let diagnostics = rows_of::<Diagnostics>(message);
        exchange.diagnostics.extend(diagnostics.map(|row| ((row.robot, row.sample_seq), row)));
    }
    exchange
}

/// All fields except times and runs, as text: floats that differ in a bit have different text.
fn timeless_sample(row: &Sample, first: &Sample) -> String {
    let mut row = *row;
    row.stamp_ns -= first.stamp_ns;
    if row.has(sample_flag::POWER) {
        row.measured_ns = row.measured_ns.wrapping_sub(first.stamp_ns);
    }
    format!("{row:?}")
}

fn timeless_forecast(row: &Forecast) -> String {
    let mut row = *row;
    row.target_ns -= row.stamp_ns;
    (row.stamp_ns, row.source_epoch) = (0, 0);
    format!("{row:?}")
}

/// The residual and the scores; alarms depend also on the worker's lateness.
fn timeless_diagnostic(row: &Diagnostic) -> String {
    let mut row = *row;
    (row.stamp_ns, row.source_epoch) = (0, 0);
    (row.alarms, row.alarm, row.level) = (0, 0, 0);
    format!("{row:?}")
}

fn same<R>(
    what: &str,
    before: &BTreeMap<(u32, u64), R>,
    after: &BTreeMap<(u32, u64), R>,
    timeless: impl Fn(&R) -> String,
) -> usize {
    let mut compared = 0;
    for (key, row) in before {
        if let Some(again) = after.get(key) {
            assert_eq!(timeless(row), timeless(again), "{what} of (robot, sample) {key:?}");
            compared += 1;
        }
    }
    compared
}

/// Stops a recorder, whose exit code reports losses.
fn end(recorder: &mut Child) -> Ended {
    let ended = recorder.end();
    let lost = ended.json()["messages_lost"].as_u64().unwrap();
    assert_eq!(ended.code(), Some(if lost > 0 { 3 } else { 0 }), "{}", ended.errors());
    ended
}

/// Records a worker and a simulated fleet from the first sample on, for `frames` frames.
fn record(arena: &Arena, name: &str, frames: u64) -> PathBuf {
    let (file, _) = without_loss(|attempt| {
        let file = arena.files().join(format!("{attempt}-{name}"));
        let mut worker = arena.worker();
        let mut recorder = arena.recording(&file, &[]);
        arena.simulate(ROBOTS, frames);
        let ended = end(&mut recorder);
        worker.stop();
        (file, ended)
    });
    file
}

/// The recording of a replay at twice the speed, and the report of the replay.
fn replayed_and_recorded(arena: &Arena, first: &Path) -> (PathBuf, Value) {
    let (recorded, _) = without_loss(|attempt| {
        let second = arena.files().join(format!("{attempt}-second.mcap"));
        let mut worker = arena.worker();
        let mut recorder = arena.recording(&second, &[]);
        let ended = alone(&["replay", first.to_str().unwrap(), "--rate", "2"]);
        let report = ended.json();
        assert_eq!(ended.code(), Some(0), "{report:#} {}", ended.errors());
        let ended = end(&mut recorder);
        worker.stop();
        ((second, report), ended)
    });
    recorded
}

#[test]
fn the_recording_of_a_replay_equals_the_original() {
    let arena = Arena::new(&Setup::simulated());
    let first = record(&arena, "first.mcap", 90);
    let (second, report) = replayed_and_recorded(&arena, &first);

    let (before, after) = (exchange(&first), exchange(&second));
    assert!(before.samples.len() >= 90 * 12, "{}", before.samples.len());
    assert_eq!(before.samples.len(), after.samples.len());
    assert_eq!(report["samples"], before.samples.len());
    let starts =
        |exchange: &Exchange| *exchange.samples.values().min_by_key(|row| row.stamp_ns).unwrap();
    let (one, other) = (starts(&before), starts(&after));
    for (key, row) in &before.samples {
        let again = &after.samples[key];
        assert_eq!(timeless_sample(row, &one), timeless_sample(again, &other), "{key:?}");
    }
    let forecasts = same("forecast", &before.forecasts, &after.forecasts, timeless_forecast);
    let residuals =
        same("diagnostic", &before.diagnostics, &after.diagnostics, timeless_diagnostic);
    assert!(forecasts > 200 && residuals > 200, "{forecasts} forecasts, {residuals} residuals");
    let second = second.to_str().unwrap();
    alone(&["replay", "--verify", second]).exits(0);
    let other =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/models/gternal-sim-power.safetensors");
    let report = alone(&["replay", second, "--model", other]).exits(0).json();
    assert_eq!(report["robots"].as_array().unwrap().len(), 12, "{report:#}");
    assert_ne!(report["recorded_model_hash"], report["other_model_hash"], "{report:#}");
}

#[test]
fn planners_can_be_developed_without_a_worker_and_from_the_middle() {
    let arena = Arena::new(&Setup::simulated());
    let file = record(&arena, "run.mcap", 90);
    let name = file.to_str().unwrap();
    let outputs = ["--topics", "forecasts", "diagnostics", "budgets"];

    // Refused beside a worker: planners could not distinguish them.
    let mut worker = arena.worker();
    let ended = alone(&[&["replay", name][..], &outputs].concat());
    assert_eq!(ended.code(), Some(1), "{}", ended.text());
    assert_contains(&ended.errors(), ["already has a worker"]);
    worker.stop();

    let second = arena.files().join("second.mcap");
    let mut recorder = arena.recording(&second, &[]);
    let span = ["--start-offset", "1.5", "--playback-duration", "1"];
    let ended = alone(&[&["replay", name][..], &outputs, &span].concat());
    let report = ended.json();
    assert_eq!(ended.code(), Some(0), "{report:#} {}", ended.errors());
    assert_eq!(report["frames_before"], 3, "{report:#}");
    // Enough is left on a busy machine too.
    recorder.end();

    let frames = |file: &Path| -> Vec<(u64, Vec<String>)> {
        let frame = |entry: Entry| {
            let Frame { header, rows } = entry.message.frame::<Forecasts>()?;
            Some((header.tick, rows.iter().map(timeless_forecast).collect()))
        };
        entries(file).into_iter().filter_map(frame).collect()
    };
    let (before, after) = (frames(&file), frames(&second));
    assert!(after.len() > 10, "{} frames", after.len());
    for (tick, rows) in &after {
        let (_, recorded) = before.iter().find(|(recorded, _)| recorded == tick).unwrap();
        assert_eq!(rows, recorded, "tick {tick}");
    }
    // Budgets from before the offset were sent first.
    let first = entries(&second)
        .into_iter()
        .find_map(|entry| Some(entry.message.frame::<Budgets>()?.header.tick));
    assert!(first.unwrap() <= after[0].0, "budgets {first:?}, forecasts {}", after[0].0);
}

#[test]
fn a_replay_can_be_stepped() {
    let arena = Arena::new(&Setup::simulated());
    let file = record(&arena, "run.mcap", 60);
    let mut planner = arena.recorder();
    let arguments = ["replay", "--step", "--no-wait", "--format", "json", file.to_str().unwrap()];
    let mut command = Command::new(program("joulebus-under-test"));
    command.args(arguments);
    let mut replay = Child::spawn("replay", command);
    let mut frames = || {
        let lines = planner.seen().iter();
        let samples = lines.filter(|line| matches!(line, ReaderLine::Samples { .. }));
        samples.count()
    };
    for step in 1..=3 {
        replay.send_line("");
        eventually("the step", || frames() >= step);
    }
    let report = replay.stop().json();
    assert_eq!(report["frames"]["samples"], 3, "{report:#}");
    assert_eq!(frames(), 3);
}
