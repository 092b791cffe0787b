//! Files of a running fleet that are removed, as by `rm` or systemd-logind's `RemoveIPC`: running
//! processes detect it and exit with the reason, and processes started afterwards work.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use joulebus_testkit::remove;
use joulebus_tests::{Arena, Child, ReaderLine, Setup, Spread, eventually, figure};
use rustix::process::Signal;

const NOTICED: &str = "while this process used it";

/// Removes the fleet's objects in shared memory with such a suffix.
fn remove_objects(arena: &Arena, end: &str) {
    let is_object = |path: &PathBuf| path.parent() == Some(Path::new("/dev/shm")) && path.is_file();
    let objects: Vec<PathBuf> = arena.stale_files().into_iter().filter(is_object).collect();
    let chosen = objects.iter().filter(|path| path.to_string_lossy().ends_with(end));
    assert_ne!(chosen.map(|path| remove(path)).count(), 0, "no {end}");
}

/// The running processes of a fleet.
struct Fleet {
    worker: Child,
    members: Vec<Child>,
}

impl Fleet {
    fn start(arena: &Arena, round: usize) -> Self {
        let worker = arena.worker();
        let capture = arena.files().join(format!("run-{round}.mcap"));
        let recorder = arena.recording(&capture, &[]);
        let controller = arena.controller("fleet", 0, 4, 30.0);
        let simulation = ["publish", "sim", "--seed", "7", "--robots", "2", "--first-robot", "20"];
        let simulation = Child::spawn("simulation", arena.command(&simulation));
        let watch = Child::spawn("watch", arena.command(&["watch", "--format", "json"]));
        let mut planner = arena.planner();
        let pid = worker.pid();
        planner.forecast("all work", |frame| {
            let works =
                frame.pid == pid && [3, 21].iter().all(|robot| frame.robot(*robot).is_some());
            works.then_some(())
        });
        assert!(!watch.lines(0, joulebus_tests::PATIENCE).is_empty());
        Self { worker, members: vec![recorder, controller, simulation, watch, planner.child] }
    }

    /// Stops the processes that have not exited.
    fn end(mut self) {
        for member in &mut self.members {
            member.end();
        }
    }
}

/// Removed files, and how they are removed.
type Removal = (&'static str, fn(&Arena));

const REMOVALS: [Removal; 9] = [
    ("the frames (.data)", |arena| remove_objects(arena, ".data")),
    ("the lists of ports (.dynamic)", |arena| {
        remove_objects(arena, ".dynamic");
    }),
    ("the worker's events (.event_mgmt)", |arena| {
        remove_objects(arena, ".event_mgmt");
    }),
    ("the descriptions (services/)", |arena| {
        remove(&arena.domain().directory().join("services"));
    }),
    ("the nodes (nodes/)", |arena| {
        remove(&arena.domain().directory().join("nodes"));
    }),
    ("the marker", |arena| {
        remove(&arena.domain().directory().join("members.lock"));
    }),
    ("the fleet's folder", |arena| {
        remove(&arena.domain().directory());
    }),
    ("the root", |arena| remove(arena.domain().root())),
    ("everything of the user, as logind does", |arena| {
        for path in arena.stale_files() {
            remove(&path);
        }
    }),
];

#[test]
fn a_worker_whose_files_are_removed_is_named_exits_with_the_reason_and_the_next_one_works() {
    let arena = Arena::new(&Setup::default());
    let mut noticed = Spread::default();
    for (round, (what, remove)) in REMOVALS.into_iter().enumerate() {
        let mut fleet = Fleet::start(&arena, round);
        let healthy = arena.run(&["doctor"]);
        assert_eq!(healthy.code(), Some(0), "{what}: {healthy:?}");
        // A stopped process cannot detect it: doctor must.
        fleet.worker.signal(Signal::STOP);
        remove(&arena);
        let ended = arena.run(&["doctor"]);
        assert_eq!(ended.code(), Some(1), "{what}: {ended:?}");
        let (pid, text) = (fleet.worker.pid().to_string(), ended.text());
        let line = text.lines().find(|line| line.contains("removed files"));
        assert!(line.is_some_and(|line| line.contains(&pid)), "{what}: {text}");
        assert!(text.contains("RemoveIPC"), "{what}: {text}");
        let begin = Instant::now();
        fleet.worker.signal(Signal::CONT);
        fleet.worker.wait_for_line(NOTICED);
        noticed.add(begin.elapsed());
        let ended = fleet.worker.wait();
        assert_eq!(ended.code(), Some(1), "{what}: {ended:?}");
        assert!(ended.errors().contains("RemoveIPC"), "{what}: {ended:?}");
        // As a supervisor would, then the others.
        let mut worker = arena.worker();
        fleet.end();
        let mut controller = arena.controller("fresh", 50, 2, 60.0);
        let mut planner = arena.planner();
        let pid = worker.pid();
        planner
            .forecast(what, |frame| (frame.pid == pid && frame.robot(50).is_some()).then_some(()));
        controller.finish();
        planner.leave();
        worker.stop();
        let fixed = arena.run(&["doctor", "--fix"]);
        assert_eq!(fixed.code(), Some(0), "{what}: {fixed:?}");
        assert_eq!(arena.stale_files(), Vec::<PathBuf>::new(), "{what}");
    }
    figure(
        "removed under a running fleet",
        format_args!("{} ways; the worker says so after {noticed}", REMOVALS.len()),
    );
}

#[test]
fn every_program_whose_files_are_removed_reports_it_and_exits() {
    let arena = Arena::new(&Setup::default());
    let fleet = Fleet::start(&arena, 0);
    for path in arena.stale_files() {
        remove(&path);
    }
    let Fleet { mut worker, members } = fleet;
    assert_eq!(worker.wait().code(), Some(1));
    for (name, mut member) in
        ["record", "controller", "publish", "watch", "planner"].into_iter().zip(members)
    {
        // A controller may continue; the library returns the error each time.
        if name == "controller" {
            let mut read = 0;
            eventually("the controller is told", || {
                let lines = member.lines(read, Duration::from_millis(50));
                read += lines.len();
                lines.iter().any(|line| line.contains(NOTICED))
            });
            member.finish();
            continue;
        }
        let ended = member.wait();
        assert_eq!(ended.code(), Some(1), "{name}: {ended:?}");
        let printed = format!("{}{}", ended.errors(), ended.text());
        assert!(printed.contains(NOTICED), "{name}: {printed}");
    }
    let info = joulebus_tests::alone(&["info", arena.files().join("run-0.mcap").to_str().unwrap()]);
    assert_eq!(info.code(), Some(0), "the capture is whole: {info:?}");
    arena.worker().stop();
}

#[test]
fn doctor_finds_no_fault_with_what_a_reader_that_has_left_had() {
    let arena = Arena::new(&Setup::default());
    let _worker = arena.worker();
    let mut planner = arena.planner();
    let mut controller = arena.controller("fleet", 0, 4, 30.0);
    planner.forecast("all work", |frame| frame.robot(3).map(|_| ()));
    for _ in 0..3 {
        // It gives up after three seconds, which may not be enough on a busy machine.
        eventually("a reader has come and left", || {
            arena.run(&["watch", "--once"]).code() == Some(0)
        });
        let healthy = arena.run(&["doctor"]);
        assert_eq!(healthy.code(), Some(0), "{healthy:?}");
    }
    controller.finish();
    planner.child.end();
}

#[test]
fn removal_of_the_lock_file_ends_the_worker_before_a_second_one_can_start() {
    let arena = Arena::new(&Setup::default());
    let mut worker = arena.worker();
    remove(&arena.domain().root().join("worker-t.lock"));
    worker.wait_for_line(NOTICED);
    assert_eq!(worker.wait().code(), Some(1));
    arena.worker().stop();
}

/// Processes that join, leave, are killed or fall behind cause no errors.
#[test]
fn no_file_is_reported_missing_while_processes_join_leave_and_are_killed() {
    let arena = Arena::new(&Setup::default());
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    for round in 0..12 {
        let mut controller = arena.controller("fleet", 0, 4, 60.0);
        let mut other = arena.planner();
        let mut seen = 0;
        other.until("it sees forecasts", |line| {
            seen += u64::from(matches!(line, ReaderLine::Forecasts(_)));
            (seen > 2).then_some(())
        });
        if round % 3 == 0 {
            controller.kill();
            other.child.kill();
        } else {
            controller.finish();
            other.leave();
        }
    }
    assert!(worker.is_running() && planner.child.is_running());
    let newest = planner.forecasts().last().map(|frame| frame.tick);
    let mut controller = arena.controller("fleet", 0, 4, 60.0);
    planner.forecast("they go on", |frame| (Some(frame.tick) > newest).then_some(()));
    controller.finish();
    let ended = planner.leave();
    assert!(!ended.errors().contains(NOTICED), "{ended:?}");
    let ended = worker.stop();
    assert!(!ended.errors().contains(NOTICED), "{ended:?}");
}
