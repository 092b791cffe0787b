//! Files of dead runs are removed at the next start. That members remove them beside living ones, and
//! that a start can be killed at any point, is tested in `bus` (`members_clean_up`, `killed_at_every`,
//! `an_object_of_size_0`).

use joulebus_tests::{Arena, Setup};
use rustix::process::Signal;

const CLEANED: &str = "removed stale files of dead processes";

/// A worker, a controller and a planner that exchange frames, all killed.
fn killed_fleet(arena: &Arena) {
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut controller = arena.controller("controller", 0, 4, 60.0);
    planner.forecast("it works", |frame| frame.robot(3).map(|_| ()));
    let mut all = [&mut worker, &mut controller, &mut planner.child];
    // All at once: none of them removes what another one has left.
    for process in &mut all {
        process.signal(Signal::KILL);
    }
    for process in all {
        process.wait();
    }
    assert!(arena.stale_files().len() > 10, "{:?}", arena.stale_files());
}

#[test]
fn row_18_stale_files_of_dead_runs_are_removed_at_the_next_start_in_one_log_line() {
    let arena = Arena::new(&Setup::default());
    killed_fleet(&arena);
    let mut worker = arena.worker();
    let ended = worker.stop();
    let lines: Vec<&String> = ended.stderr.iter().filter(|line| line.contains(CLEANED)).collect();
    assert_eq!(lines.len(), 1, "{}", ended.errors());
    assert!(lines[0].contains("cold: true"), "{}", lines[0]);
    assert_eq!(arena.stale_files(), Vec::<std::path::PathBuf>::new());
    // Nothing was left this time: nothing is logged.
    let ended = arena.worker().stop();
    assert!(!ended.errors().contains(CLEANED), "{}", ended.errors());
}

#[test]
fn row_18_doctor_does_not_touch_files_in_use() {
    let arena = Arena::new(&Setup::default());
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    arena.controller("dead", 0, 4, 60.0).kill();
    let mut controller = arena.controller("living", 10, 2, 60.0);
    planner.forecast("it works", |frame| frame.robot(10).map(|_| ()));
    let ended = arena.run(&["doctor", "--fix"]);
    assert_eq!(ended.code(), Some(0), "{ended:?}");
    let newest = planner
        .forecasts()
        .last()
        .map(|frame| (frame.tick, frame.robot(10).map(|line| line.sample_seq)));
    planner.forecast("and continues", |frame| {
        let now = Some((frame.tick, frame.robot(10).map(|line| line.sample_seq)));
        (now > newest).then_some(())
    });
    controller.finish();
    planner.leave();
    let report = worker.stop().json();
    assert_eq!(report["frames_unsent"], 0);
    assert_eq!(report["receive_errors"], 0);
}
