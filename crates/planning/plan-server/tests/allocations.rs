//! While the thread answers questions, the tick of the same process allocates nothing of its own:
//! only iceoryx2 0.10 does, once for each of the frames of a tick.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use joulebus_bus::{Bus, clock};
use joulebus_config::Config;
use joulebus_plan::{Plan, Question};
use joulebus_plan_server::PlanServer;
use joulebus_planner::PlanClient;
use joulebus_predictor_worker::Worker;
use joulebus_testkit::{OnDrop, counting};
use joulebus_wire::{Alarm, SCHEMA_VERSION, Sample, SampleHeader};

#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;

const ROBOTS: u32 = 20;
/// Timeout of waiting for a condition.
const PATIENCE: Duration = Duration::from_secs(180);

fn config(root: &std::path::Path) -> Config {
    let text = format!(
        "[fleet]\nname = \"asked\"\ncapacity = {ROBOTS}\n\
         [domain]\nroot = \"{}\"\nprefix = \"t_\"\n\
         [tick]\nrate_hz = 200.0\ndeadline_ms = 2.0\n\
         [ledger]\ncheckpoint = \"\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-19\"]\n",
        root.display()
    );
    Config::parse(&text, &root.join("nowhere")).unwrap()
}

fn feed(config: &Config, stop: &AtomicBool) {
    let bus = Bus::join(&config.domain().unwrap(), "source").unwrap();
    let mut writer = bus.sample_writer(&config.limits(), ROBOTS as usize).unwrap();
    let mut header = SampleHeader {
        schema: SCHEMA_VERSION,
        source_id: 1,
        source_epoch: clock::monotonic_ns(),
        ..SampleHeader::default()
    };
    while !stop.load(Ordering::Relaxed) {
        let (seq, now_ns) = (header.frame_seq, clock::monotonic_ns());
        (header.sent_ns, header.intended_ns) = (now_ns, now_ns);
        let sample = |place: usize| {
            Sample::new(place as u32, seq, now_ns)
                .command(0.1, 0.5)
                .reading(3.5 + (seq % 9) as f32 * 0.01, now_ns)
        };
        writer.send(header, ROBOTS as usize, sample).unwrap();
        header.frame_seq += 1;
        header.samples_before += u64::from(ROBOTS);
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn ask(config: &Config, answered: &AtomicU64, stop: &AtomicBool) {
    let mut client = PlanClient::with_config(config, "client").unwrap();
    let question = Question {
        plan: Plan::Idle { robots: vec![0, 7, 19], duration_s: 10.0 },
        coverage: 0.9,
        power: false,
        moments: 0,
    };
    while !stop.load(Ordering::Relaxed) {
        match client.ask(&question, PATIENCE) {
            Ok(_) => {
                answered.fetch_add(1, Ordering::Relaxed);
            }
            Err(_) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

#[test]
fn while_questions_are_answered_the_tick_allocates_nothing_of_its_own() {
    let root = PathBuf::from(format!("/dev/shm/joulebus-test-asked-{}", std::process::id()));
    let config = config(&root);
    let server = PlanServer::start(&config, None).unwrap();
    let mut worker = Worker::open(&config).unwrap();
    server.serve();
    server.wait_until_open();
    let (answered, stop) = (AtomicU64::new(0), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let _end = OnDrop(&stop);
        scope.spawn(|| feed(&config, &stop));
        scope.spawn(|| ask(&config, &answered, &stop));
        // Waits for at least that many ticks and answers.
        let tick = |worker: &mut Worker, ticks: u64, answers: u64| {
            let (begin, mut done) = (Instant::now(), 0);
            let before = answered.load(Ordering::Relaxed);
            while done < ticks || answered.load(Ordering::Relaxed) < before + answers {
                done += u64::from(worker.poll().unwrap());
                assert!(begin.elapsed() < PATIENCE, "no answers");
            }
            done
        };
        tick(&mut worker, 200, 50);
        let shed_before = worker.report().ticks_without_diagnostics;
        let before = counting::calls();
        let ticks = tick(&mut worker, 300, 200);
        let allocated = counting::calls() - before;
        let shed = worker.report().ticks_without_diagnostics - shed_before;
        assert_eq!(
            allocated,
            5 * ticks - shed,
            "five a tick are iceoryx2's, {shed} without diagnostics"
        );
    });
    // No channel leads from this thread to the worker, as on a host without one.
    let mut client = PlanClient::with_config(&config, "person").unwrap();
    let refused = client.acknowledge(7, Alarm::LevelHigh, "ann", true, PATIENCE).unwrap_err();
    assert!(refused.to_string().contains("no worker that takes a new normal"), "{refused}");
    drop(client);
    let report = server.finish();
    assert!(report.answered >= 250, "{report:?}");
    let _ = worker.finish();
    let _ = std::fs::remove_dir(&root);
    assert!(!root.exists(), "stale files: {root:?}");
}
