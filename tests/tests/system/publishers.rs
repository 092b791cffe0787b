//! Row 1: publishers are killed at any point.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_testkit::OnDrop;
use joulebus_tests::{
    Answers, Arena, Child, Dice, PATIENCE, Planner, ReaderLine, Setup, SourceLine, Spread, figure,
    sample,
};
use joulebus_wire::{InvalidReason, Quality, Sample};

/// Robots of the killed controller.
const KILLED: u32 = 0;
const ROBOTS: u32 = 4;
/// Robots of the other source.
const OTHERS: [u32; 4] = [50, 51, 52, 53];
/// Period of that source.
const PACE: Duration = Duration::from_millis(15);

fn other(seq: u64, setup: &Setup) -> Vec<Sample> {
    OTHERS.map(|robot| sample(robot, seq, setup.period_ns())).to_vec()
}

/// Sends samples of the other robots until stopped; returns their answers and the pid of the
/// source.
fn play_others(
    arena: &Arena,
    setup: &Setup,
    sent: &AtomicU64,
    stop: impl Fn(u64) -> bool,
    pace: Duration,
) -> (Answers, u32) {
    let mut planner = arena.planner();
    let mut source = arena.source("others");
    let mut seq = 0;
    while !stop(seq) {
        let frame = other(seq, setup);
        source.send(&frame);
        planner.answered(&frame);
        seq += 1;
        sent.store(seq, Ordering::Relaxed);
        std::thread::sleep(pace);
    }
    let answers = planner.answers(|robot| OTHERS.contains(&robot));
    let pid = source.child.pid();
    source.leave();
    planner.leave();
    (answers, pid)
}

/// Starts a controller and waits until a forecast answers a sample of this run. Returns the
/// controller, its start time and the time at which the forecast was read, monotonic ns.
fn start(arena: &Arena, planner: &mut Planner) -> (Child, u64, u64) {
    let started_ns = clock::monotonic_ns();
    let controller = arena.controller("controller", KILLED, ROBOTS, 30.0);
    let lines = controller.lines(0, PATIENCE);
    let ready = lines.first().and_then(|line| serde_json::from_str(line).ok());
    let Some(SourceLine::Ready { source_epoch }) = ready else {
        panic!("failed restart: {}", controller.tail());
    };
    let answered_ns = planner.forecast("the restarted controller is answered", |frame| {
        let line = frame.robot(KILLED)?;
        (line.source_epoch == source_epoch && line.stamp_ns > started_ns).then_some(frame.read_ns)
    });
    (controller, started_ns, answered_ns)
}

/// After a kill the robot is in open loop, and then invalid as stale. Returns whether open loop was
/// seen: a worker or planner that waits for a CPU misses it.
fn assert_goes_stale(planner: &mut Planner) -> bool {
    let (mut steps, mut of_ns) = (Vec::new(), 0);
    planner.forecast("its robots go stale", |frame| {
        let line = frame.robot(KILLED)?;
        // A sample sent before the kill and taken late: fewer steps are overdue after it.
        if line.stamp_ns != of_ns {
            steps.clear();
            of_ns = line.stamp_ns;
        }
        match line.quality() {
            Quality::Invalid(InvalidReason::Stale) => Some(()),
            Quality::OpenLoop { steps: step } => {
                steps.push(step);
                None
            }
            // Samples sent before the kill are still answered. After a pause they fill the window
            // anew.
            Quality::Fresh | Quality::Held | Quality::Warmup { .. } => {
                steps.clear();
                None
            }
            quality => panic!("{quality:?} after {steps:?}"),
        }
    });
    assert!(steps.is_sorted(), "{steps:?}");
    !steps.is_empty()
}

#[test]
fn row_1_killed_publishers_do_not_affect_others_and_every_restart_works() {
    let mut dice = Dice::roll();
    let rounds = Dice::rounds("JOULEBUS_PUBLISHER_KILLS", 32);
    let setup = Setup {
        tick_hz: 100.0,
        rate_hz: 30.0,
        // Long enough to observe the open loop on a busy machine.
        stale_after_s: 1.0,
        ..Setup::default()
    };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut recorder = arena.recorder();
    let mut planner = arena.planner();
    let (stop, sent) = (AtomicBool::new(false), AtomicU64::new(0));
    let (mut outage, mut starting) = (Spread::default(), 0);
    let (mut stale, mut open_loop) = (0, 0);
    let (answers, others_pid) = std::thread::scope(|scope| {
        let others = scope
            .spawn(|| play_others(&arena, &setup, &sent, |_| stop.load(Ordering::Relaxed), PACE));
        // The other source must stop even if this thread panics.
        let _stopped = OnDrop(&stop);
        let (mut controller, ..) = start(&arena, &mut planner);
        for round in 0..rounds {
            let goes_stale = round % 4 == 3;
            if goes_stale {
                planner.quality("it is forecast", KILLED, |quality| quality == Quality::Fresh);
            }
            // Random time of the kill, not a wait for a condition.
            std::thread::sleep(dice.time_below(Duration::from_millis(150)));
            let killed_ns = clock::monotonic_ns();
            assert_eq!(controller.kill().signal(), Some(9));
            if goes_stale {
                stale += 1;
                open_loop += u64::from(assert_goes_stale(&mut planner));
            }
            if round % 2 == 1 {
                // Another one is killed during its start.
                let mut unfinished = arena.controller("controller", KILLED, ROBOTS, 30.0);
                std::thread::sleep(dice.time_below(Duration::from_millis(25)));
                unfinished.kill();
                starting += 1;
            }
            let (next, _, answered_ns) = start(&arena, &mut planner);
            if round % 2 == 0 {
                outage.add_ns(answered_ns - killed_ns);
            }
            controller = next;
        }
        planner.quality("all is well in the end", KILLED, |quality| quality == Quality::Fresh);
        controller.finish();
        stop.store(true, Ordering::Relaxed);
        others.join().expect("the others are answered")
    });

    let (mut read, mut torn) = (0, 0);
    for line in recorder.seen() {
        match line {
            // The scripted source has different samples.
            ReaderLine::Samples { samples, torn: broken, pid } if *pid != others_pid => {
                read += samples;
                torn += broken;
            }
            ReaderLine::Failed(error) => panic!("{error}"),
            _ => {}
        }
    }
    assert!(read > 0);
    planner.leave();
    recorder.leave();
    let report = worker.stop().json();

    let clean = Arena::new(&setup);
    let mut worker = clean.worker();
    let frames = sent.load(Ordering::Relaxed);
    let (expected, _) = play_others(&clean, &setup, &sent, |seq| seq == frames, Duration::ZERO);
    worker.stop();
    let mut compared = 0;
    for (key, answer) in &answers {
        // A planner that waited for a CPU may have missed a frame.
        let Some(expected) = expected.get(key) else {
            continue;
        };
        assert_eq!(expected, answer, "robot {} sample {}", key.0, key.1);
        compared += 1;
    }
    assert!(compared * 10 >= frames * 4 * 9, "{compared} answers of {frames} frames");
    assert_eq!(torn, 0, "torn samples of {read}");
    assert_eq!(report["frames_unsent"], 0);
    assert!(open_loop * 2 >= stale, "open loop before {open_loop} of {stale} stale ones");
    figure("row 1, outage from the kill to the first answer after the restart", &outage);
    figure(
        "row 1, kills",
        format_args!(
            "{rounds} while sending, {starting} while starting, failed restarts 0, files left 0"
        ),
    );
    figure("row 1, torn samples", format_args!("0 of {read}"));
    figure("row 1, other robots", format_args!("{compared} answers, 0 differ by a bit"));
}
