//! Rows 3 and 4: killed and stopped planners do not affect the worker.

use std::time::Duration;

use joulebus_tests::{
    Arena, Child, Dice, Planner, ReaderLine, Setup, Spread, figure, sample, tick_ns,
};
use joulebus_wire::Sample;
use rustix::process::Signal;

const ROBOTS: [u32; 4] = [0, 1, 2, 3];

fn frame(seq: u64, setup: &Setup) -> Vec<Sample> {
    ROBOTS.map(|robot| sample(robot, seq, setup.period_ns())).to_vec()
}

#[test]
fn row_3_killed_planners_cost_the_worker_no_frame_and_their_loans_are_reclaimed() {
    let mut dice = Dice::roll();
    let rounds = Dice::rounds("JOULEBUS_PLANNER_KILLS", 40);
    let setup = Setup::default();
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut witness = arena.planner();
    let mut source = arena.source("fleet");
    let mut seq = 0;
    let mut play = |witness: &mut Planner| {
        let frame = frame(seq, &setup);
        source.send(&frame);
        witness.answered(&frame);
        seq += 1;
    };
    play(&mut witness);
    let mut starting = 0;
    for round in 0..rounds {
        let mut planner = Planner::new(Child::spawn("holder", arena.probe(&["holder"])));
        if round % 2 == 0 {
            planner
                .until("it holds a frame", |line| matches!(line, ReaderLine::Holds).then_some(()));
        } else {
            starting += 1;
        }
        // Random time of the kill, not a wait for a condition.
        std::thread::sleep(dice.time_below(Duration::from_millis(20)));
        planner.child.kill();
        play(&mut witness);
    }
    // Without the reclaimed slots and loans these could not join.
    let holders: Vec<Planner> = (0..2)
        .map(|_| {
            let mut holder = Planner::new(Child::spawn("holder", arena.probe(&["holder"])));
            holder
                .until("it holds a frame", |line| matches!(line, ReaderLine::Holds).then_some(()));
            holder
        })
        .collect();
    for _ in 0..20 {
        play(&mut witness);
    }
    for holder in holders {
        holder.leave();
    }
    source.leave();
    witness.leave();
    let report = worker.stop().json();
    assert_eq!(report["frames_unsent"], 0, "{report}");
    assert_eq!(report["receive_errors"], 0, "{report}");
    figure(
        "row 3, frames unsent",
        format_args!(
            "0 of {} ticks, {rounds} planners killed, {starting} of them while starting",
            report["ticks"]
        ),
    );
}

#[test]
fn row_4_a_stopped_planner_does_not_affect_the_worker_and_resumes_at_the_newest_with_one_gap() {
    const FRAMES: u64 = 150;
    let setup = Setup::default();
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut witness = arena.planner();
    let mut stopped = arena.consumer();
    let mut source = arena.source("fleet");
    let mut play = |witness: &mut Planner, seq| {
        let frame = frame(seq, &setup);
        source.send(&frame);
        witness.answered(&frame)
    };
    for seq in 0..10 {
        play(&mut witness, seq);
    }
    stopped
        .until("a frame is given", |line| matches!(line, ReaderLine::Given { .. }).then_some(()));
    stopped.child.signal(Signal::STOP);
    // Twice the planner's buffers: after this all frames it has not read are overwritten.
    let first = play(&mut witness, 10);
    let last = (11..10 + FRAMES).map(|seq| play(&mut witness, seq)).last().unwrap();
    stopped.child.signal(Signal::CONT);

    let between = last.tick - first.tick;
    let mut gaps_before = None;
    let (tick, missed, gaps) = stopped.until("it resumes", |line| match line {
        ReaderLine::Given { tick, ticks_missed, gaps, .. } if *ticks_missed + 20 >= between => {
            Some((*tick, *ticks_missed, *gaps))
        }
        ReaderLine::Given { gaps, tick, .. } => {
            assert!(*tick <= first.tick + 5, "an old frame after it resumed: tick {tick}");
            gaps_before = Some(*gaps);
            None
        }
        ReaderLine::Failed(error) => panic!("{error}"),
        _ => None,
    });
    assert!(tick >= last.tick, "resumed at tick {tick}, the newest was {}", last.tick);
    if let Some(before) = gaps_before {
        assert_eq!(gaps, before + 1, "one gap");
    }
    let next = stopped.until("and continues", |line| match line {
        ReaderLine::Given { tick, .. } => Some(*tick),
        _ => None,
    });
    assert!(next > tick);
    let mut ticks = Spread::default();
    for frame in witness.forecasts().filter(|frame| (first.tick..=last.tick).contains(&frame.tick))
    {
        ticks.add_ns(tick_ns(frame));
    }
    figure(
        "row 4, while a planner is stopped",
        format_args!(
            "{FRAMES} of {FRAMES} frames answered, {} ticks skipped, resumed at the newest with one gap of {missed}",
            last.ticks_skipped - first.ticks_skipped
        ),
    );
    figure("row 4, start of a tick to its forecasts sent, planner stopped", &ticks);
    source.leave();
    witness.leave();
    stopped.leave();
    let report = worker.stop().json();
    assert_eq!(report["frames_unsent"], 0, "{report}");
}
