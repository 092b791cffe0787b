//! Guarantees of a source, between separate processes.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

#[path = "../examples/controller.rs"]
#[allow(dead_code, reason = "its `main`")]
mod controller;

use std::path::Path;

use joulebus_bus::{Bus, FrameBuf, SampleReader, Waiter};
use joulebus_connect::findings::implausible_robots;
use joulebus_publisher::{Config, PublishError, Publisher, RobotState, clock};
use joulebus_testkit::{TestFleet, eventually, next_order, run_member, send_to_test};
use joulebus_wire::{SCHEMA_VERSION, Sample, SampleHeader, sample_flag};

/// Not a test: the entry point of the processes that the tests start.
#[test]
fn member() {
    run_member(|role, config| match role {
        "example" => example(config),
        "worker" => worker(config),
        "source" => source(config),
        "alone" => alone(config),
        "implausible" => implausible(config),
        "misuse" => misuse(config),
        _ => panic!("no such role: {role}"),
    });
}

struct Intake {
    reader: SampleReader,
    buffer: FrameBuf,
    arrivals: Waiter,
    _bus: Bus,
}

impl Intake {
    fn new(config: &Path) -> Self {
        let config = Config::load(config).unwrap();
        let bus = Bus::join(&config.domain().unwrap(), "worker").unwrap();
        let reader = bus.sample_reader(&config.limits()).unwrap();
        let arrivals = bus.arrivals_waiter(&config.limits()).unwrap();
        Self { reader, arrivals, buffer: FrameBuf::new(config.limits().capacity), _bus: bus }
    }

    fn take(&mut self) -> Option<(SampleHeader, Vec<Sample>)> {
        let taken = self.reader.take(&mut self.buffer).unwrap();
        taken.then(|| (*self.buffer.header(), self.buffer.samples().to_vec()))
    }
}

fn example(config: &Path) {
    send_to_test(controller::run(config, 7).unwrap());
}

/// Receives frames, checks that each is complete, and reports each run of the source after the
/// requested number of frames.
fn worker(config: &Path) {
    let mut intake = Intake::new(config);
    send_to_test("ready");
    let mut known_epoch = 0;
    while let Some(wanted) = next_order() {
        let wanted: u64 = wanted.parse().unwrap();
        let (mut frames, mut samples, mut newest) = (0, 0, SampleHeader::default());
        while frames < wanted {
            intake.arrivals.wait_until(None, None).unwrap();
            while let Some((header, robots)) = intake.take() {
                check(&header, &robots);
                if header.source_epoch <= known_epoch {
                    continue;
                }
                assert!(frames == 0 || newest.frame_seq < header.frame_seq);
                (frames, samples, newest) = (frames + 1, samples + robots.len(), header);
            }
        }
        known_epoch = newest.source_epoch;
        send_to_test(format!("{frames} {samples} {} {}", newest.source_id, newest.source_epoch));
    }
}

/// Twenty robots, each with one sample per frame so far.
fn check(header: &SampleHeader, robots: &[Sample]) {
    assert_eq!(header.schema, SCHEMA_VERSION);
    assert!(header.sent_ns >= header.intended_ns && header.intended_ns > 0);
    assert_eq!(header.samples_before, header.frame_seq * 20);
    assert_eq!(robots.len(), 20);
    for (i, sample) in robots.iter().enumerate() {
        assert_eq!((sample.robot, sample.seq), (i as u32, header.frame_seq));
        assert!(sample.has(sample_flag::POWER | sample_flag::V | sample_flag::OMEGA));
        assert!(sample.stamp_ns <= header.sent_ns);
    }
}

#[test]
fn the_worker_receives_every_frame_of_the_example() {
    let fleet = TestFleet::new();
    let mut worker = fleet.start("worker");
    assert_eq!(worker.next_line(), "ready");
    worker.send_line("7");
    let mut example = fleet.start("example");
    assert_eq!(example.next_line(), "140");
    let took = worker.next_line();
    example.finish();
    assert!(took.starts_with("7 140 "), "{took}");
}

/// Publishes until it is killed.
fn source(config: &Path) {
    let mut publisher = Publisher::connect(config, "example-controller").unwrap();
    let robot = |robot| RobotState::new(robot).command(0.1, 0.0).reading(3.0);
    loop {
        publisher.publish((0..20).map(robot)).unwrap();
        std::thread::sleep(std::time::Duration::from_micros(200));
    }
}

#[test]
fn a_restarted_source_has_the_same_id_and_a_greater_epoch() {
    let fleet = TestFleet::new();
    let mut worker = fleet.start("worker");
    assert_eq!(worker.next_line(), "ready");
    let mut before: Option<(u64, u64)> = None;
    for life in 0..6 {
        worker.send_line("3");
        let source = fleet.start("source");
        let took = worker.next_line();
        source.kill();
        let numbers: Vec<u64> = took.split(' ').map(|word| word.parse().unwrap()).collect();
        let [frames, samples, id, epoch] = numbers[..] else {
            panic!("{took}");
        };
        assert!(frames >= 3 && samples == frames * 20, "life {life}: {took}");
        if let Some((id_before, epoch_before)) = before {
            assert_eq!(id, id_before, "life {life}");
            assert!(epoch > epoch_before, "life {life}");
        }
        before = Some((id, epoch));
    }
}

/// A source without a worker, until one starts.
fn alone(config: &Path) {
    let mut publisher = Publisher::connect(config, "alone").unwrap();
    let robots = || (0..3).map(RobotState::new);
    for frame in 0..20 {
        let sent = publisher.publish(robots()).unwrap();
        assert_eq!((sent.readers, sent.frame_seq), (0, frame));
    }
    let mut intake = Intake::new(config);
    assert_eq!(publisher.publish(robots()).unwrap().readers, 1);
    let (header, samples) = intake.take().unwrap();
    assert_eq!((header.frame_seq, header.samples_before), (20, 60));
    assert_eq!(samples.len(), 3);
    drop(intake);
    assert_eq!(publisher.publish(robots()).unwrap().readers, 0);
    assert_eq!(publisher.frames_sent(), 22);
    assert_eq!(publisher.samples_sent(), 66);
}

#[test]
fn a_source_needs_no_worker_and_reports_to_a_late_one_what_it_missed() {
    let fleet = TestFleet::new();
    fleet.start("alone").finish();
}

/// Publishes a power of the wrong sign, until the fleet's readers know.
fn implausible(config: &Path) {
    let loaded = Config::load(config).unwrap();
    let mut publisher = Publisher::with_config(&loaded, "implausible").unwrap();
    let robot = |robot: u32, frame: u32| {
        let power_w = 4.0 + 0.1 * ((frame + robot) % 7) as f32;
        let turned = if robot == 2 { -power_w } else { power_w };
        RobotState::new(robot).command(0.1, 0.0).reading(turned)
    };
    let mut frames = 0..;
    eventually("the alarm of robot 2", || {
        let frame = frames.next().unwrap_or_default();
        publisher.publish((0..3).map(|id| robot(id, frame))).unwrap();
        implausible_robots(&loaded).into_keys().eq([2])
    });
    drop(publisher);
    assert!(implausible_robots(&loaded).is_empty());
}

#[test]
fn what_a_source_publishes_is_judged_and_the_judgement_ends_with_it() {
    let fleet = TestFleet::new();
    fleet.start("implausible").finish();
}

/// Frames that are refused, and values that are sent unchecked.
fn misuse(config: &Path) {
    let mut publisher = Publisher::connect(config, "misuse").unwrap();
    let mut intake = Intake::new(config);
    let robots = |count| (0..count).map(RobotState::new);
    for _ in 0..2 {
        assert!(matches!(
            publisher.publish(robots(70)),
            Err(PublishError::TooMany { found: 70, allowed: 64 })
        ));
        assert!(matches!(
            publisher.publish(robots(3).chain([RobotState::new(1)])),
            Err(PublishError::DuplicateRobot { robot: 1 })
        ));
    }
    let long = vec![Sample::new(1, 0, 1); 65];
    let refused = publisher.publish_samples(1, &long).unwrap_err();
    assert!(refused.to_string().contains("65 samples, allowed are 64"));
    assert_eq!(publisher.frames_sent(), 0);
    assert!(intake.take().is_none(), "no frame was sent");

    assert_eq!(publisher.publish(robots(64)).unwrap().samples, 64);
    let wild = RobotState::new(0).command(f32::INFINITY, f32::NAN).reading(f32::NAN);
    publisher.publish([wild]).unwrap();
    assert_eq!(publisher.publish([]).unwrap().samples, 0);
    let mine = Sample::new(9, 77, clock::monotonic_ns()).reading(-2.0, 5);
    publisher.publish_samples(3, &[mine]).unwrap();

    let (header, samples) = intake.take().unwrap();
    assert_eq!((header.frame_seq, samples.len()), (0, 64));
    let (header, samples) = intake.take().unwrap();
    assert_eq!((header.frame_seq, header.samples_before), (1, 64));
    assert!(samples[0].has(sample_flag::POWER) && samples[0].power_w.is_nan());
    assert_eq!(samples[0].v_mps, f32::INFINITY);
    let (header, samples) = intake.take().unwrap();
    assert_eq!((header.frame_seq, samples.len()), (2, 0));
    let (header, samples) = intake.take().unwrap();
    assert_eq!((header.frame_seq, header.samples_before), (3, 65));
    assert_eq!((header.intended_ns, samples[0].seq), (3, 77));
    assert_eq!(samples[0].power_w, -2.0);
}

#[test]
fn a_refused_frame_does_not_affect_later_ones() {
    let fleet = TestFleet::new();
    fleet.start("misuse").finish();
}

#[test]
fn a_missing_config_is_an_error_that_names_it() {
    let error = Publisher::connect("/no/such/fleet.toml", "x").err().unwrap();
    assert!(error.to_string().contains("/no/such/fleet.toml"), "{error}");
}
