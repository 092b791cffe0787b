//! The worker's loop, ingest and publishing included, allocates nothing of its own after warm-up,
//! even while a planner and a recorder read: only iceoryx2 0.10 does, once for each of the six
//! frames of a tick.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use joulebus_bus::{Bus, Domain, clock};
use joulebus_config::Config;
use joulebus_predictor_worker::Worker;
use joulebus_testkit::{OnDrop, counting};
use joulebus_wire::{Outlooks, PlanStates, SCHEMA_VERSION, Sample, SampleHeader, State, Statement};

#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;

/// Timeout of waiting for a condition.
const PATIENCE: Duration = Duration::from_secs(180);

/// A run: tick policy, number of robots, number of threads.
#[derive(Debug, Clone, Copy)]
struct Case {
    policy: &'static str,
    robots: u32,
    threads: u32,
}

fn config(root: &Path, case: Case) -> Config {
    let Case { policy, robots, threads } = case;
    let capacity = robots + 24;
    let text = format!(
        "[fleet]\nname = \"alloc\"\ncapacity = {capacity}\n\
         [domain]\nroot = \"{}\"\nprefix = \"t_\"\n\
         [tick]\npolicy = \"{policy}\"\nrate_hz = 200.0\ndeadline_ms = 2.0\n\
         [worker]\nthreads = {threads}\nthreads_from = 1\n\
         [ledger]\ncheckpoint = \"\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-{robots}\"]\n",
        root.display()
    );
    Config::parse(&text, &root.join("nowhere")).unwrap()
}

/// Publishes frames with missing, refused, unknown and late robots, and with missing readings.
fn feed(domain: &Domain, config: &Config, robots: u32, sent: &AtomicU64, stop: &AtomicBool) {
    let bus = Bus::join(domain, "source").unwrap();
    let mut writer = bus.sample_writer(&config.limits(), robots as usize).unwrap();
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
            let robot = place as u32 + u32::from((seq / 7).is_multiple_of(2));
            let sample = Sample::new(robot, seq, now_ns);
            match (seq + place as u64) % 50 {
                0 => sample.command(0.1, 0.5).reading(f32::NAN, now_ns),
                1 => sample.command(0.1, 0.5),
                2 => sample.reading(3.5, now_ns),
                3 => Sample::new(90_000, seq, now_ns),
                _ => sample.command(0.1, 0.5).reading(3.5 + (seq % 9) as f32 * 0.01, now_ns),
            }
        };
        writer.send(header, robots as usize, sample).unwrap();
        header.frame_seq += 1;
        sent.store(header.frame_seq, Ordering::Relaxed);
        header.samples_before += u64::from(robots);
        std::thread::sleep(Duration::from_millis(if seq.is_multiple_of(40) { 60 } else { 5 }));
    }
}

/// Reads plan states and outlooks until `stop`, and counts the ticks of which it found both.
fn plan(domain: &Domain, config: &Config, plan_states: &AtomicU64, stop: &AtomicBool) {
    let bus = Bus::join(domain, "planner").unwrap();
    let mut reader = bus.reader::<PlanStates>(&config.limits()).unwrap();
    let mut outlooks = bus.reader::<Outlooks>(&config.limits()).unwrap();
    while !stop.load(Ordering::Relaxed) {
        let found = (reader.take_latest().unwrap(), outlooks.take_latest().unwrap());
        let both = found.0.is_some() && found.1.is_some();
        plan_states.fetch_add(u64::from(both), Ordering::Relaxed);
        drop(found);
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Reads keyframes until `stop`, and counts the complete ones.
fn record(domain: &Domain, config: &Config, keyframes: &AtomicU32, stop: &AtomicBool) {
    let bus = Bus::join(domain, "recorder").unwrap();
    let mut states = bus.reader::<State>(&config.limits()).unwrap();
    let mut bytes = 0;
    while !stop.load(Ordering::Relaxed) {
        while let Some(piece) = states.take_next().unwrap() {
            bytes =
                if piece.header().offset == 0 { 0 } else { bytes } + piece.payload().len() as u64;
            let is_whole = bytes == piece.header().total_bytes;
            keyframes.fetch_add(u32::from(is_whole), Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Allocations so far of the pool's other threads.
fn others() -> Vec<u64> {
    if rayon::current_thread_index().is_none() {
        return Vec::new();
    }
    let counts = rayon::broadcast(|context| (context.index(), counting::calls()));
    let others = counts.into_iter().filter(|(thread, _)| *thread > 0);
    others.map(|(_, calls)| calls).collect()
}

fn measure(case: Case) {
    let root = PathBuf::from(format!("/dev/shm/joulebus-test-alloc-{}", std::process::id()));
    let config = config(&root, case);
    let domain = config.domain().unwrap();
    let (sent, keyframes) = (AtomicU64::new(0), AtomicU32::new(0));
    let plan_states = AtomicU64::new(0);
    let stop = AtomicBool::new(false);
    let mut worker = Worker::open(&config).unwrap();
    let (ask, statements) = sync_channel(4);
    worker.take_statements_from(statements, Arc::default());
    std::thread::scope(|scope| {
        let _end = OnDrop(&stop);
        scope.spawn(|| feed(&domain, &config, case.robots, &sent, &stop));
        scope.spawn(|| plan(&domain, &config, &plan_states, &stop));
        // Waits for at least that many ticks, and until the other threads have done their part: on
        // a busy machine ticks continue without them.
        let tick = |worker: &mut Worker, ticks: u64, frames: u64, wanted_keyframes: u32| {
            let (begin, mut done) = (Instant::now(), 0);
            while done < ticks
                || sent.load(Ordering::Relaxed) < frames
                || keyframes.load(Ordering::Relaxed) < wanted_keyframes
                || plan_states.load(Ordering::Relaxed) == 0
            {
                // A statement in each tick, of which there is always room for one more.
                let has_ticked = worker.poll().unwrap();
                done += u64::from(has_ticked);
                assert!(
                    !has_ticked || ask.try_send((7, Statement::Charge(0.9))).is_ok(),
                    "the tick before took it"
                );
                assert!(begin.elapsed() < PATIENCE, "no frame or no keyframe");
            }
            done
        };
        tick(&mut worker, 200, 100, 0);
        let shed_before = worker.report().ticks_without_diagnostics;
        let (before, others_before) = (counting::calls(), others());
        scope.spawn(|| record(&domain, &config, &keyframes, &stop));
        let spawned = counting::calls() - before;
        let ticks = tick(&mut worker, 300, 300, 1);
        let allocated = counting::calls() - before - spawned;
        stop.store(true, Ordering::Relaxed);
        assert_eq!(others(), others_before, "{case:?}: the other threads");
        // On a busy machine diagnostics may be shed.
        let shed = worker.report().ticks_without_diagnostics - shed_before;
        assert_eq!(
            allocated,
            6 * ticks - shed,
            "{case:?}: six a tick are iceoryx2's, {shed} ticks without diagnostics"
        );
    });
    let report = worker.finish();
    assert!(report.samples_accepted > 5_000, "{report:?}");
    assert!(report.samples_dropped["UnknownRobot"] > 0, "{report:?}");
    assert!(report.samples_dropped["NotFinite"] > 0, "{report:?}");
    let _ = std::fs::remove_dir(&root);
    assert!(!root.exists(), "stale files: {root:?}");
}

#[test]
fn after_warm_up_the_worker_allocates_nothing_of_its_own() {
    let few = |policy| Case { policy, robots: 40, threads: 1 };
    measure(few("on_frame"));
    measure(few("timer"));
    // Enough robots for each thread to get a part.
    measure(Case { policy: "on_frame", robots: 1_000, threads: 2 });
}
