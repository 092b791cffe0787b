//! Publishers are killed at any point. That other robots keep the same bits is tested by `floods` and
//! in each seed of the simulator, and that another source loses no frame by `random_faults`.

use std::time::Duration;

use joulebus_bus::clock;
use joulebus_tests::{
    Arena, Child, Dice, PATIENCE, Planner, ReaderLine, Setup, SourceLine, Spread, figure,
};
use joulebus_wire::{InvalidReason, Quality};

/// Robots of the killed controller.
const KILLED: u32 = 0;
const ROBOTS: u32 = 4;

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
fn robots_of_killed_publishers_are_bridged_and_go_stale_and_every_restart_works() {
    let mut dice = Dice::roll();
    let rounds = Dice::rounds("JOULEBUS_PUBLISHER_KILLS", 16);
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
    let mut outage = Spread::default();
    let (mut stale, mut open_loop) = (0, 0);
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
        }
        let (next, _, answered_ns) = start(&arena, &mut planner);
        if round % 2 == 0 {
            outage.add_ns(answered_ns - killed_ns);
        }
        controller = next;
    }
    planner.quality("all is well in the end", KILLED, |quality| quality == Quality::Fresh);
    controller.finish();

    let (mut read, mut torn) = (0, 0);
    for line in recorder.seen() {
        match line {
            ReaderLine::Samples { samples, torn: broken, .. } => {
                read += samples;
                torn += broken;
            }
            ReaderLine::Failed(error) => panic!("{error}"),
            _ => {}
        }
    }
    assert!(read > 0);
    assert_eq!(torn, 0, "torn samples of {read}");
    planner.leave();
    recorder.leave();
    assert_eq!(worker.stop().json()["frames_unsent"], 0);
    assert!(open_loop * 2 >= stale, "open loop before {open_loop} of {stale} stale ones");
    figure("outage from the kill of a publisher to the first answer after the restart", &outage);
}
