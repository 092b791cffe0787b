//! Rows 5 and 22: too many samples from one source, and too many robots for the period.

use std::time::Instant;

use joulebus_tests::{
    Answers, Arena, Forge, FrameLine, Planner, ReaderLine, Setup, Source, figure, sample, script,
};
use joulebus_wire::{Refusal, Sample};
use serde_json::Value;

const ROBOTS: [u32; 6] = [0, 1, 2, 3, 4, 5];
const FLOODED: [u32; 6] = [50, 51, 52, 53, 54, 55];
/// Frames of the flood per frame of the others.
const TIMES: u64 = 10;
const FRAMES: u64 = 150;

/// Result of a run with or without the flood.
struct Run {
    answers: Answers,
    report: Value,
    refused: Vec<Refusal>,
    flooded: u64,
    flood_pid: u32,
}

/// One round of the flood: each robot's samples at ten times the platform's rate.
fn burst(round: u64, setup: &Setup) -> Vec<FrameLine> {
    (0..TIMES)
        .map(|place| {
            let seq = round * TIMES + place;
            let samples = FLOODED
                .map(|robot| Sample { seq, ..sample(robot, seq, setup.period_ns() / TIMES) });
            FrameLine::new(&samples, Forge::default())
        })
        .collect()
}

fn run(setup: &Setup, with_flood: bool) -> Run {
    let arena = Arena::new(setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    let mut flood: Option<Source> = with_flood.then(|| arena.source("flood"));
    let mut flooded = 0;
    for (round, frame) in (0..).zip(&script(&ROBOTS, FRAMES, setup.period_ns())) {
        if let Some(flood) = &mut flood {
            flood.send_all(&burst(round, setup));
            flooded += TIMES * FLOODED.len() as u64;
        }
        source.send(frame);
        planner.answered(frame);
    }
    let flood_pid = flood.as_ref().map_or(0, |flood| flood.child.pid());
    let answers = planner.answers(|robot| ROBOTS.contains(&robot));
    let refused = refusals(&mut planner);
    if let Some(flood) = flood {
        flood.leave();
    }
    source.leave();
    planner.leave();
    let report = worker.stop().json();
    Run { answers, report, refused, flooded, flood_pid }
}

/// All refusals reported so far.
fn refusals(planner: &mut Planner) -> Vec<Refusal> {
    let lines = planner.seen().iter();
    let frames = lines.filter_map(|line| match line {
        ReaderLine::Diagnostics(frame) => Some(frame.refusals()),
        _ => None,
    });
    frames.flatten().copied().collect()
}

#[test]
fn row_5_a_source_that_floods_tenfold_loses_only_its_own_samples() {
    let setup = Setup::default();
    let clean = run(&setup, false);
    let flooded = run(&setup, true);

    // All samples of the others are answered, with the same bits.
    let wanted = ROBOTS.len() * FRAMES as usize;
    assert_eq!(clean.report["samples_accepted"], wanted as u64);
    let mut compared = 0;
    for (key, answer) in &flooded.answers {
        // A planner that waited for a CPU may have missed a frame, and reports it.
        let Some(expected) = clean.answers.get(key) else {
            continue;
        };
        assert_eq!(expected, answer, "robot, sample {key:?}");
        compared += 1;
    }
    assert!(compared * 10 >= wanted * 9, "{compared} answers of {wanted}");

    // Every sample is accepted or dropped with a reason, and all dropped ones are of the flood.
    let dropped = flooded.report["samples_dropped"].as_object().unwrap();
    let drops: u64 = dropped.values().map(|count| count.as_u64().unwrap()).sum();
    let accepted = flooded.report["samples_accepted"].as_u64().unwrap();
    assert_eq!(accepted + drops, wanted as u64 + flooded.flooded, "{}", flooded.report);
    assert!(drops > 0, "{}", flooded.report);
    for refusal in &flooded.refused {
        assert!(FLOODED.contains(&refusal.robot), "{refusal:?}");
        assert_eq!(refusal.pid, flooded.flood_pid, "{refusal:?}");
    }
    assert_eq!(flooded.report["frames_unsent"], 0, "{}", flooded.report);

    let tick = |run: &Run, quantile: &str| run.report["tick"][quantile].as_f64().unwrap();
    figure(
        "row 5, a tenfold flood",
        format_args!(
            "0 of {compared} answers of others differ, {} samples of the flood: {} accepted, \
             {dropped:?} dropped; tick p99.9 {:.0} µs beside {:.0} µs without it, p50 {:.0} beside \
             {:.0}",
            flooded.flooded,
            accepted - wanted as u64,
            tick(&flooded, "p999_us"),
            tick(&clean, "p999_us"),
            tick(&flooded, "p50_us"),
            tick(&clean, "p50_us"),
        ),
    );
}

#[test]
fn row_22_overload_skips_ticks_sheds_diagnostics_first_and_ends_by_itself() {
    const MANY: u32 = 60_000;
    let setup = Setup {
        capacity: MANY,
        policy: "timer",
        // A period too short for a tick of so many robots, even one without samples on a fast
        // machine, and long enough for a few.
        tick_hz: 1000.0,
        robots: "0-59999",
        // On a busy machine a sample of each may take seconds: before the first one leaves.
        rate_hz: 2.0,
        stale_after_s: 8.0,
        leave_after_s: 8.0,
        more: "power_max_w = 10000.0\n".to_owned(),
        ..Setup::default()
    };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut watcher = arena.consumer();
    let mut robots_given = |what: &str, wanted: u32| {
        watcher.until(what, |line| match line {
            ReaderLine::Given { robots, tick, .. } => (*robots == wanted as usize).then_some(*tick),
            _ => None,
        })
    };
    let mut many = arena.controller("many", 0, MANY, setup.rate_hz);
    robots_given("the many have joined", MANY);
    worker.wait_for_line("diagnostics are left out");
    many.finish();
    let left = Instant::now();
    // They leave eight seconds after their last sample, without intervention. Until then their
    // robots are owned: samples of another source would be refused.
    let emptied = robots_given("the many have left", 0);
    let mut planner = arena.planner();
    planner.until("diagnostics again", |line| match line {
        ReaderLine::Diagnostics(frame) => (frame.tick > emptied).then_some(()),
        _ => None,
    });
    let recovered_s = left.elapsed().as_secs_f64();
    worker.wait_for_line("diagnostics resume");

    // Afterwards, new samples are answered as before.
    let mut source = arena.source("few");
    let frames = script(&ROBOTS, 10, setup.period_ns());
    planner.play(&mut source, &frames);
    source.leave();
    watcher.leave();
    planner.leave();
    let report = worker.stop().json();
    let (skipped, shed) = (&report["ticks_skipped"], &report["ticks_without_diagnostics"]);
    assert!(skipped.as_u64() > Some(0), "{report}");
    assert!(shed.as_u64() > Some(0), "{report}");
    assert!(shed.as_u64() < report["ticks"].as_u64(), "{report}");
    figure(
        "row 22, overload",
        format_args!(
            "{skipped} ticks skipped, {shed} of {} without diagnostics, the longest {:.0} ms of a \
             period of 1 ms; {recovered_s:.1} s from the last sample of the many, who leave after 8 s, \
             to diagnostics again",
            report["ticks"],
            report["tick"]["max_us"].as_f64().unwrap() * 1e-3,
        ),
    );
}
