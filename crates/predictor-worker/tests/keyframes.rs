//! A reader of keyframes and journals can recompute every tick bit for bit, from the first or a
//! later keyframe; without readers there is no cost.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use joulebus_bus::{Bus, FrameBuf, clock};
use joulebus_config::Config;
use joulebus_fleet::{Fleet, FleetState};
use joulebus_models::load_models;
use joulebus_predictor_worker::Worker;
use joulebus_testkit::OnDrop;
use joulebus_wire::{
    Budget, Budgets, Forecast, Forecasts, Outlooks, PlanStates, SCHEMA_VERSION, Sample,
    SampleHeader, State, StateHeader, Statement, TakenFrame, TickHeader, Ticks, tick_flag,
};

const ROBOTS: u32 = 300;
/// What persons state of batteries.
const STATED: [(u32, Statement); 3] =
    [(7, Statement::Charge(0.25)), (8, Statement::Exchanged), (299, Statement::Full)];
/// Timeout of waiting for a condition.
const PATIENCE: Duration = Duration::from_secs(180);

fn eventually(mut condition: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !condition() {
        assert!(begun.elapsed() < PATIENCE, "not after {PATIENCE:?}");
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn config(root: &Path) -> Config {
    let text = format!(
        "[fleet]\nname = \"keyframes\"\ncapacity = {ROBOTS}\n\
         [domain]\nroot = \"{}\"\nprefix = \"t_\"\n\
         [tick]\nrate_hz = 100.0\ndeadline_ms = 5.0\n\
         [intake]\nbuffer_frames = 64\n\
         [ledger]\ncheckpoint = \"\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-{}\"]\n",
        root.display(),
        ROBOTS - 1
    );
    Config::parse(&text, &root.join("nowhere")).unwrap()
}

#[derive(Default)]
struct Recorded {
    samples: HashMap<(u64, u64), (SampleHeader, Vec<Sample>)>,
    ticks: BTreeMap<u64, (TickHeader, Vec<TakenFrame>)>,
    forecasts: BTreeMap<u64, Vec<Forecast>>,
    budgets: BTreeMap<u64, Vec<Budget>>,
    keyframes: BTreeMap<u64, FleetState>,
}

/// Reads until `stop`; reports that it has started, and the last tick that it has read.
fn record(config: &Config, ready: &AtomicBool, read: &AtomicU64, stop: &AtomicBool) -> Recorded {
    let (domain, limits) = (config.domain().unwrap(), config.limits());
    let bus = Bus::join(&domain, "recorder").unwrap();
    let mut waiter = bus.planner_waiter(&limits).unwrap();
    let mut samples = bus.sample_reader(&limits).unwrap();
    let mut ticks = bus.reader::<Ticks>(&limits).unwrap();
    let mut forecasts = bus.reader::<Forecasts>(&limits).unwrap();
    let mut budgets = bus.reader::<Budgets>(&limits).unwrap();
    let mut states = bus.reader::<State>(&limits).unwrap();
    let mut frame = FrameBuf::new(limits.capacity);
    let (mut recorded, mut pieces) = (Recorded::default(), Vec::new());
    ready.store(true, Ordering::Relaxed);
    while !stop.load(Ordering::Relaxed) {
        while samples.take(&mut frame).unwrap() {
            let key = (frame.header().source_epoch, frame.header().frame_seq);
            let kept = (*frame.header(), frame.samples().to_vec());
            recorded.samples.insert(key, kept);
        }
        while let Some(frame) = ticks.take_next().unwrap() {
            let tick = frame.header().tick;
            recorded.ticks.insert(tick, (*frame.header(), frame.payload().to_vec()));
            read.store(tick, Ordering::Relaxed);
        }
        while let Some(frame) = forecasts.take_next().unwrap() {
            recorded.forecasts.insert(frame.header().tick, frame.payload().to_vec());
        }
        while let Some(frame) = budgets.take_next().unwrap() {
            recorded.budgets.insert(frame.header().tick, frame.payload().to_vec());
        }
        while let Some(piece) = states.take_next().unwrap() {
            add_piece(piece.header(), piece.payload(), &mut pieces, &mut recorded);
        }
        waiter.wait_until(None, None).unwrap();
    }
    recorded
}

fn add_piece(header: &StateHeader, piece: &[u8], pieces: &mut Vec<u8>, recorded: &mut Recorded) {
    if header.offset == 0 {
        pieces.clear();
    }
    if header.offset != pieces.len() as u64 {
        return; // A piece is missing: the next keyframe follows.
    }
    pieces.extend_from_slice(piece);
    if pieces.len() as u64 == header.total_bytes {
        let state = FleetState::decode(pieces).unwrap();
        recorded.keyframes.insert(header.tick, state);
    }
}

/// Publishes valid and invalid samples until `stop`.
fn feed(config: &Config, stop: &AtomicBool) {
    let bus = Bus::join(&config.domain().unwrap(), "source").unwrap();
    let limits = config.limits();
    let mut writer = bus.sample_writer(&limits, ROBOTS as usize).unwrap();
    let mut header = SampleHeader {
        schema: SCHEMA_VERSION,
        source_id: 1,
        source_epoch: clock::unix_ns(),
        ..SampleHeader::default()
    };
    while !stop.load(Ordering::Relaxed) {
        let (seq, now_ns) = (header.frame_seq, clock::monotonic_ns());
        (header.sent_ns, header.intended_ns) = (now_ns, now_ns);
        let sample = |place: usize| {
            let sample = Sample::new(place as u32, seq, now_ns);
            match (seq * 7 + place as u64) % 40 {
                0 => sample.command(0.1, 0.5).reading(f32::NAN, now_ns),
                1 => sample.command(0.1, 0.5),
                2 => sample.command(9.0, 0.5),
                _ => {
                    let power_w = 3.5 + (seq % 9) as f32 * 0.01 + place as f32 * 1e-3;
                    sample.command(0.1, 0.5).reading(power_w, now_ns)
                }
            }
        };
        writer.send(header, ROBOTS as usize, sample).unwrap();
        header.frame_seq += 1;
        header.samples_before += u64::from(ROBOTS);
        std::thread::sleep(Duration::from_millis(10 + 40 * u64::from(seq % 30 == 0)));
    }
}

/// Recomputes the ticks from the keyframe of `from` and compares; returns the number of ticks
/// compared.
fn verify(config: &Config, recorded: &Recorded, from: u64) -> usize {
    let models = load_models(config).unwrap();
    let mut fleet = Fleet::new(config.settings().clone(), models).unwrap();
    fleet.restore_state(&recorded.keyframes[&from]).unwrap();
    let mut compared = 0;
    for tick in from + 1.. {
        let Some((header, taken)) = recorded.ticks.get(&tick) else {
            break;
        };
        for taken in taken {
            if let Some((robot, stated)) = taken.statement() {
                fleet.take_statement(robot, stated, taken.taken_ns);
                continue;
            }
            if let Some((source_id, epoch)) = taken.ended_source() {
                fleet.end_source(source_id, epoch);
                continue;
            }
            let key = (taken.source_epoch, taken.frame_seq);
            let Some((header, samples)) = recorded.samples.get(&key) else {
                return compared; // The recorder was too slow, which this test does not cover.
            };
            fleet.take(header, samples, taken.taken_ns);
        }
        fleet.tick(header.start_ns, header.flags & tick_flag::DEADLINE_MISSED != 0);
        for (place, forecast) in recorded.forecasts.get(&tick).into_iter().flatten().enumerate() {
            let again = fleet.forecast(place);
            assert_eq!(format!("{forecast:?}"), format!("{again:?}"), "tick {tick}");
            assert_eq!(forecast.power_w.to_bits(), again.power_w.to_bits(), "tick {tick}");
            compared += 1;
        }
        for (place, budget) in recorded.budgets.get(&tick).into_iter().flatten().enumerate() {
            let again = fleet.budget(place);
            assert_eq!(format!("{budget:?}"), format!("{again:?}"), "tick {tick}");
        }
        if let Some(keyframe) = recorded.keyframes.get(&tick) {
            let bytes = [keyframe, &fleet.state()].map(|state| {
                let mut bytes = Vec::new();
                state.encode_into(&mut bytes);
                bytes
            });
            assert!(bytes[0] == bytes[1], "the state after tick {tick}");
        }
    }
    compared
}

#[test]
fn every_tick_can_be_recomputed_from_the_first_and_from_a_later_keyframe() {
    let root = format!("/dev/shm/joulebus-test-keyframes-{}", std::process::id());
    let root = PathBuf::from(root);
    let config = config(&root);
    let [early_ready, late_ready, stop] = [const { AtomicBool::new(false) }; 3];
    // Before its first tick a recorder delays nothing.
    let [read_early, read_late] = [const { AtomicU64::new(u64::MAX) }; 2];
    let (early, late) = std::thread::scope(|scope| {
        let _end = OnDrop(&stop);
        let early = scope.spawn(|| record(&config, &early_ready, &read_early, &stop));
        eventually(|| early_ready.load(Ordering::Relaxed));
        let mut worker = Worker::open(&config).unwrap();
        let (ask, statements) = sync_channel(8);
        let stated = Arc::default();
        worker.take_statements_from(statements, Arc::clone(&stated));
        scope.spawn(|| feed(&config, &stop));
        // Ticks only when both have read all but the last few, because on a busy machine frames
        // would be overwritten before they are read.
        let mut run = |ticks: u32| {
            let mut done = 0;
            while done < ticks {
                done += u32::from(worker.poll().unwrap());
                let tick = worker.report().ticks;
                let is_read =
                    |read: &AtomicU64| read.load(Ordering::Relaxed) >= tick.saturating_sub(4);
                eventually(|| is_read(&read_early) && is_read(&read_late));
            }
        };
        run(150);
        // One of them is not in the fleet.
        for robot in [7, 8, 9_999] {
            ask.send((robot, Statement::NewNormal)).unwrap();
        }
        for stated in STATED {
            ask.send(stated).unwrap();
        }
        assert_eq!(stated.load(Ordering::Acquire), 0);
        run(1);
        assert_eq!(stated.load(Ordering::Acquire), 3 + STATED.len() as u64);
        let late = scope.spawn(|| record(&config, &late_ready, &read_late, &stop));
        // Tick only after the late reader has opened its ports, and wait for its first frame. It
        // may get no processor for so long that frames are overwritten.
        eventually(|| late_ready.load(Ordering::Relaxed));
        run(1);
        eventually(|| read_late.load(Ordering::Relaxed) != u64::MAX);
        run(300);
        stop.store(true, Ordering::Relaxed);
        let _ = worker.finish();
        (early.join().unwrap(), late.join().unwrap())
    });
    assert!(early.keyframes.contains_key(&0), "the state before the first tick");
    let taken = early.ticks.values().flat_map(|(_, taken)| taken);
    let statements: Vec<_> = taken.filter_map(TakenFrame::statement).collect();
    let normals = [7, 8, 9_999].map(|robot| (robot, Statement::NewNormal));
    assert_eq!(statements, [&normals[..], &STATED].concat());
    let compared = verify(&config, &early, 0);
    assert!(compared > 100 * ROBOTS as usize, "{compared} forecasts compared");
    let first = *late.keyframes.keys().next().expect("a late reader gets a keyframe at once");
    assert!(first > 0);
    let compared = verify(&config, &late, first);
    assert!(compared > 20 * ROBOTS as usize, "{compared} forecasts compared");
    // Keyframes of the same tick are the same for both.
    let both = early.keyframes.keys().filter(|tick| late.keyframes.contains_key(tick));
    assert!(both.count() > 0, "all readers get the same keyframes");
    let _ = std::fs::remove_dir(&root);
    assert!(!root.exists(), "stale files: {root:?}");
}

#[test]
fn a_flood_of_frames_holds_no_new_normal_back() {
    let root = PathBuf::from(format!("/dev/shm/joulebus-test-flood-{}", std::process::id()));
    let text = format!(
        "[fleet]\nname = \"flood\"\ncapacity = 1\n\
         [domain]\nroot = \"{}\"\nprefix = \"t_\"\n\
         [intake]\nbuffer_frames = 2\nmax_sources = 1\n\
         [ledger]\ncheckpoint = \"\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0\"]\n",
        root.display()
    );
    let config = Config::parse(&text, &root.join("nowhere")).unwrap();
    let mut worker = Worker::open(&config).unwrap();
    let (ask, statements) = sync_channel(1);
    worker.take_statements_from(statements, Arc::default());
    let bus = Bus::join(&config.domain().unwrap(), "source").unwrap();
    let mut writer = bus.sample_writer(&config.limits(), 1).unwrap();
    let mut ticks = bus.reader::<Ticks>(&config.limits()).unwrap();
    let mut header = SampleHeader {
        schema: SCHEMA_VERSION,
        source_id: 1,
        source_epoch: clock::unix_ns(),
        ..SampleHeader::default()
    };
    for _ in 0..5 {
        ask.try_send((0, Statement::NewNormal)).expect("the tick before took it");
        let mut has_ticked = false;
        while !has_ticked {
            // As many as are buffered, which is as many as a journal lists.
            for _ in 0..2 {
                header.sent_ns = clock::monotonic_ns();
                let sample = Sample::new(0, header.frame_seq, header.sent_ns).command(0.1, 0.5);
                writer.send(header, 1, |_| sample).unwrap();
                (header.frame_seq, header.samples_before) =
                    (header.frame_seq + 1, header.samples_before + 1);
            }
            has_ticked = worker.poll().unwrap();
        }
    }
    while let Some(frame) = ticks.take_next().unwrap() {
        assert!(frame.header().unlisted > 0, "{:?}", frame.header());
    }
    drop((writer, ticks, bus));
    let _ = worker.finish();
    let _ = std::fs::remove_dir(&root);
    assert!(!root.exists(), "stale files: {root:?}");
}

#[test]
fn plan_states_and_outlooks_are_computed_while_somebody_reads_them() {
    let root = format!("/dev/shm/joulebus-test-on-demand-{}", std::process::id());
    let config = config(&PathBuf::from(root));
    let (domain, limits) = (config.domain().unwrap(), config.limits());
    let mut worker = Worker::open(&config).unwrap();
    let bus = Bus::join(&domain, "recorder").unwrap();
    let mut ticks = bus.reader::<Ticks>(&limits).unwrap();
    let mut written = || {
        let mut done = 0;
        while done < 3 {
            done += u32::from(worker.poll().unwrap());
        }
        let mut flags = None;
        while let Some(frame) = ticks.take_next().unwrap() {
            flags = Some(frame.header().flags);
        }
        flags.unwrap() & (tick_flag::PLAN_STATES | tick_flag::OUTLOOKS)
    };
    assert_eq!(written(), 0);
    let outlooks = bus.reader::<Outlooks>(&limits).unwrap();
    assert_eq!(written(), tick_flag::OUTLOOKS);
    let plan_states = bus.reader::<PlanStates>(&limits).unwrap();
    assert_eq!(written(), tick_flag::PLAN_STATES | tick_flag::OUTLOOKS);
    drop(outlooks);
    assert_eq!(written(), tick_flag::PLAN_STATES);
    drop(plan_states);
    assert_eq!(written(), 0);
}
