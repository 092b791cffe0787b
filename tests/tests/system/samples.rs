//! Rows 8, 9 and 21: planners learn which samples were refused, and bursts are accounted for. That
//! no refused sample moves a bit of another robot is tested without processes (`fleet`'s tests
//! `intake`, `independence`, `oracle` and `recycling`).

use joulebus_tests::{
    Arena, Forge, FrameLine, ReaderLine, Setup, accounted, figure, names, sample, script,
};
use joulebus_wire::{DropReason, Sample};

#[test]
fn refused_samples_are_counted_by_reason_and_name_robot_and_process() {
    let setup = Setup { capacity: 6, robots: "0-9", ..Setup::default() };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let (mut owner, mut second) = (arena.source("owner"), arena.source("second"));
    let frames = script(&[0, 1, 2, 3, 4, 5], 12, setup.period_ns());
    planner.play(&mut owner, &frames);
    let next = |robot| sample(robot, 12, setup.period_ns());
    let not_finite = Sample { power_w: f32::NAN, ..next(0) };
    let valid = [1, 2, 3, 4, 5].map(next);
    owner.send(&[&[not_finite], &valid[..]].concat());
    planner.answered(&valid);
    owner.send(&valid[..1]);
    // An owned robot, an unknown one, and one too many.
    second.send(&[3, 10, 6].map(next));
    let frame = planner.forecast("all is accounted for", |frame| {
        (accounted(frame) >= 12 * 6 + 7 + 3).then(|| frame.clone())
    });
    assert_eq!(frame.samples_accepted, 12 * 6 + 5);
    let named = planner.until("diagnostics", |line| match line {
        ReaderLine::Diagnostics(found) if found.tick >= frame.tick => Some(found.clone()),
        _ => None,
    });
    let (owner_pid, second_pid) = (owner.child.pid(), second.child.pid());
    for (robot, reason, pid) in [
        (0, DropReason::NotFinite, owner_pid),
        (1, DropReason::Duplicate, owner_pid),
        (3, DropReason::ForeignSource, second_pid),
        (10, DropReason::UnknownRobot, second_pid),
        (6, DropReason::OverCapacity, second_pid),
    ] {
        assert_eq!(frame.samples_dropped.get(reason), 1, "{reason:?}");
        assert!(names(&named, robot, reason, pid), "{reason:?}: {:?}", named.refused);
    }
    owner.leave();
    second.leave();
    planner.leave();
    let ended = worker.stop();
    assert!(ended.errors().contains("OverCapacity"), "operators read it: {}", ended.errors());
}

#[test]
fn row_9_in_bursts_samples_sent_equal_accepted_plus_dropped_by_reason() {
    let setup = Setup {
        buffer_frames: 4,
        tick_hz: 50.0,
        // Samples lost in a burst are gaps, which the robot's rate must allow.
        rate_hz: 10.0,
        ..Setup::default()
    };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut sources = [arena.source("one"), arena.source("two")];
    let frames = script(&[0, 1, 2], 600, setup.period_ns());
    for burst in frames.chunks(150) {
        for (source, shift) in sources.iter_mut().zip([0, 10]) {
            let shifted = |sample: &Sample| Sample { robot: sample.robot + shift, ..*sample };
            let line = |frame: &Vec<Sample>| {
                let samples: Vec<Sample> = frame.iter().map(shifted).collect();
                FrameLine::new(&samples, Forge::default())
            };
            source.send_all(&burst.iter().map(line).collect::<Vec<_>>());
        }
    }
    // Losses of the last frames are known from the next frame's header.
    let last: Vec<Sample> = [0, 1, 2].map(|robot| sample(robot, 600, setup.period_ns())).to_vec();
    sources[0].send(&last);
    let other: Vec<Sample> =
        last.iter().map(|sample| Sample { robot: sample.robot + 10, ..*sample }).collect();
    sources[1].send(&other);
    let total = 2 * 3 * 601;
    let frame = planner.forecast("all is accounted for", |frame| {
        (accounted(frame) >= total).then(|| frame.clone())
    });
    assert_eq!(accounted(&frame), total, "sent = accepted + dropped: {frame:?}");
    let budgets = planner.until("budgets", |line| match line {
        ReaderLine::Budgets(budgets) if budgets.tick >= frame.tick => Some(budgets.clone()),
        _ => None,
    });
    let line = |robot| *budgets.robot(robot).unwrap();
    for robot in [0, 1, 2, 10, 11, 12].map(line) {
        let elapsed_ns = robot.metered_ns + robot.unmetered_ns;
        assert_eq!(elapsed_ns % setup.period_ns(), 0);
        assert!(elapsed_ns <= 600 * setup.period_ns());
    }
    let report = {
        for source in sources {
            source.leave();
        }
        planner.leave();
        worker.stop().json()
    };
    figure(
        "row 9, bursts",
        format_args!(
            "{total} sent = {} accepted + {:?}",
            frame.samples_accepted,
            frame.samples_dropped.iter().collect::<Vec<_>>()
        ),
    );
    assert_eq!(report["receive_errors"], 0);
}

#[test]
fn more_successive_sources_than_slots_are_all_accepted() {
    const PLACES: u32 = 2;
    const NAMES: u32 = 4 * PLACES + 1;
    let setup = Setup {
        tick_hz: 100.0,
        rate_hz: 50.0,
        stale_after_s: 0.5,
        leave_after_s: 1.0,
        max_sources: PLACES,
        ..Setup::default()
    };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    for name in 0..NAMES {
        let mut controller = arena.controller(&format!("source-{name}"), name, 1, 50.0);
        planner.forecast("it is heard", |frame| {
            let line = frame.robots.iter().find(|line| line.robot == name)?;
            (line.flags & 1 != 0).then_some(())
        });
        controller.finish();
    }
    planner.leave();
    let report = worker.stop().json();
    assert!(report["samples_accepted"].as_u64() > Some(5 * u64::from(NAMES)));
}
