//! Row 18: files of dead runs are removed at the next start. That a start can be killed at any
//! point is tested in `bus` (`killed_at_every`).

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use joulebus_tests::{Arena, PATIENCE, Setup, eventually, figure};
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

/// Starts a worker, a controller and a planner, waits until the planner has received forecasts of
/// the controller's robots, and stops all. Returns the time since the start of the worker, and the
/// logs.
fn works(arena: &Arena, first: u32) -> (Duration, String) {
    let begin = Instant::now();
    let mut worker = arena.worker();
    let mut controller = arena.controller(&format!("fresh-{first}"), first, 2, 60.0);
    let mut planner = arena.planner();
    let pid = worker.pid();
    planner.forecast("a forecast of a fresh worker, controller and planner", |frame| {
        (frame.pid == pid && frame.robot(first).is_some()).then_some(())
    });
    let elapsed = begin.elapsed();
    let ended = [controller.finish(), planner.leave(), worker.stop()];
    (elapsed, ended.map(|ended| ended.errors()).join("\n"))
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
    works(&arena, 10);
}

#[test]
fn row_18_after_a_killed_worker_the_last_process_to_leave_removes_its_files() {
    let arena = Arena::new(&Setup::default());
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let _source = arena.source("fleet");
    let pid = worker.pid();
    planner.forecast("it works", |frame| (frame.pid == pid).then_some(()));
    worker.kill();
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

#[test]
fn trap_1_empty_files_do_not_block_a_start_with_or_without_running_processes() {
    let arena = Arena::new(&Setup::default());
    let plant = |name: &str| {
        let path = Path::new("/dev/shm").join(format!("{}{name}", arena.domain().shm_prefix()));
        fs::File::create(&path).unwrap();
        path
    };
    killed_fleet(&arena);
    for object in arena.stale_files().iter().filter(|path| path.is_file()) {
        fs::OpenOptions::new().write(true).truncate(true).open(object).unwrap();
    }
    let planted = plant("0.connection");
    let (cold, _) = works(&arena, 0);
    assert!(!planted.exists());

    let mut controller = arena.controller("living", 10, 2, 60.0);
    assert!(!controller.lines(0, PATIENCE).is_empty());
    let planted = plant("1.connection");
    let (warm, _) = works(&arena, 20);
    eventually("a running process removes it", || !planted.exists());
    controller.finish();
    figure(
        "trap 1, ready in spite of files of length zero",
        format_args!("{cold:?} cold, {warm:?} with somebody alive"),
    );
}
