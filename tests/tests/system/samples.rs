//! Planners learn which samples were refused. That no refused sample moves a bit of another robot is
//! tested without processes (`fleet`'s tests `intake`, `independence`, `oracle` and `recycling`), and
//! that sent = accepted + dropped in bursts by `floods`.

use joulebus_tests::{Arena, ReaderLine, Setup, accounted, names, sample, script};
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
