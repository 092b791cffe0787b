//! Speed of verifying a capture of 100 robots: a figure, no guarantee.
//!
//! `cargo test --release -p joulebus-capture-verify speed -- --ignored --nocapture`

use std::sync::mpsc::sync_channel;
use std::time::Instant;

use joulebus_capture_format::{
    Attachments, CaptureSettings, Entry, Message, Reader, Times, Writer,
};
use joulebus_capture_verify::{Verification, Verifier};
use joulebus_fleet::Fleet;
use joulebus_settings::FleetSettings;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source, healthy};
use joulebus_wire::{
    BudgetHeader, Budgets, DiagnosticHeader, Diagnostics, ForecastHeader, Forecasts,
    SCHEMA_VERSION, Sample, Samples, State, StateHeader, TakenFrame, TickHeader, Ticks, fnv1a,
};

const ROBOTS: u32 = 100;
/// Two minutes at 30 Hz.
const TICKS: u64 = 3_600;
/// Ticks between two keyframes, and from the state to the keyframe's arrival.
const KEYFRAME_EVERY: u64 = 150;
const KEYFRAME_LATE: u64 = 3;
const START_NS: u64 = 60_000 * MS;

fn settings() -> FleetSettings {
    let mut settings = world::settings(ROBOTS);
    settings.platforms.truncate(1);
    settings
}

fn new_fleet() -> Fleet {
    let models = world::models().into_iter().take(1).collect();
    Fleet::new(settings(), models).unwrap()
}

/// The messages of a worker and one controller for one tick.
fn turn(fleet: &mut Fleet, source: &mut Source, tick: u64) -> Vec<Message> {
    let now_ns = START_NS + tick * PERIOD_NS;
    let sample = |robot| -> Sample { healthy(robot, tick, now_ns, PERIOD_NS) };
    let samples: Vec<Sample> = (0..ROBOTS).map(sample).collect();
    let frame = source.frame(samples.len());
    fleet.take(&frame, &samples, now_ns);
    let intake = fleet.tick(now_ns + MS, false);
    let (schema, worker_epoch) = (SCHEMA_VERSION, 1);
    let (first_intended_ns, first_sent_ns, first_taken_ns) = intake.first.unwrap();
    let forecasts = ForecastHeader {
        schema,
        worker_epoch,
        tick,
        model_hash: fleet.model_hash(),
        capacity: ROBOTS,
        frames_taken: intake.frames,
        first_intended_ns,
        first_sent_ns,
        first_taken_ns,
        compute_start_ns: now_ns + MS,
        samples_accepted: fleet.accepted(),
        samples_dropped: fleet.drops(),
        ..ForecastHeader::default()
    };
    let diagnostics = DiagnosticHeader {
        schema,
        worker_epoch,
        tick,
        refused: fleet.refusals(),
        platforms: fleet.platform_memories(),
        ..DiagnosticHeader::default()
    };
    let budgets = BudgetHeader { schema, worker_epoch, tick, ..BudgetHeader::default() };
    let journal =
        TickHeader { schema, worker_epoch, tick, start_ns: now_ns + MS, ..TickHeader::default() };
    let taken = TakenFrame {
        source_id: frame.source_id,
        source_epoch: frame.source_epoch,
        frame_seq: frame.frame_seq,
        taken_ns: now_ns,
        samples: ROBOTS,
        truncated: 0,
    };
    let robots = 0..fleet.len();
    vec![
        Message::of::<Samples>(frame, samples),
        Message::of::<Forecasts>(forecasts, robots.clone().map(|at| fleet.forecast(at)).collect()),
        Message::of::<Diagnostics>(
            diagnostics,
            robots.clone().map(|at| fleet.diagnostic(at)).collect(),
        ),
        Message::of::<Budgets>(budgets, robots.map(|at| fleet.budget(at)).collect()),
        Message::of::<Ticks>(journal, vec![taken]),
    ]
}

fn capture() -> Vec<u8> {
    let (mut fleet, mut source) = (new_fleet(), Source::new(1, 1));
    let attachments = Attachments::default();
    let mut writer = Writer::new(Vec::new(), CaptureSettings::default(), &attachments).unwrap();
    let mut before_hash = 0;
    let mut keyframe = |fleet: &Fleet, tick| {
        let mut state = Vec::new();
        fleet.state().encode_into(&mut state);
        let hash = fnv1a(state.iter().copied());
        let header = StateHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: 1,
            tick,
            total_bytes: state.len() as u64,
            before_hash: std::mem::replace(&mut before_hash, hash),
            ..StateHeader::default()
        };
        Message::of::<State>(header, state)
    };
    let first = keyframe(&fleet, 0);
    writer.write("lab", Times::default(), &first).unwrap();
    let mut late = None;
    for tick in 1..=TICKS {
        let times = Times { log_ns: tick * PERIOD_NS, publish_ns: tick * PERIOD_NS };
        for message in turn(&mut fleet, &mut source, tick) {
            writer.write("lab", times, &message).unwrap();
        }
        // It comes after later ticks.
        if tick % KEYFRAME_EVERY == KEYFRAME_LATE
            && let Some(message) = late.take()
        {
            writer.write("lab", times, &message).unwrap();
        }
        if tick.is_multiple_of(KEYFRAME_EVERY) {
            late = Some(keyframe(&fleet, tick));
        }
    }
    writer.finish().unwrap().2
}

fn verify(entries: impl Iterator<Item = Entry>) -> Verification {
    let models = world::models().into_iter().take(1).collect();
    let mut verifier = Verifier::new(settings(), models).unwrap();
    entries.for_each(|entry| verifier.push(entry));
    verifier.finish()
}

#[test]
#[ignore = "prints a figure: CONTRIBUTING.md has the command"]
fn how_fast_a_capture_is_verified() {
    let bytes = capture();
    println!("{:.0} s, {:.1} MB", TICKS as f64 / 30.0, bytes.len() as f64 / 1e6);
    for threads in [1, 2] {
        let mut best_s = f64::MAX;
        for _ in 0..5 {
            let begun = Instant::now();
            let reader = Reader::new(&bytes[..]).unwrap().map(Result::unwrap);
            let report = if threads == 1 {
                verify(reader)
            } else {
                std::thread::scope(|scope| {
                    let (give, take) = sync_channel(16);
                    scope.spawn(move || {
                        let mut batch = Vec::new();
                        for entry in reader {
                            batch.push(entry);
                            if batch.len() == 64 {
                                give.send(std::mem::take(&mut batch)).unwrap();
                            }
                        }
                        give.send(batch).unwrap();
                    });
                    verify(take.into_iter().flatten())
                })
            };
            best_s = best_s.min(begun.elapsed().as_secs_f64());
            assert!(report.is_clean(), "{report}");
            assert_eq!(report.ticks_verified, TICKS);
        }
        let ratio = TICKS as f64 / 30.0 / best_s;
        println!("{threads} threads: {best_s:.3} s, {ratio:.0} times real time");
    }
}
