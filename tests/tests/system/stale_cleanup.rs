//! Row 18, and the traps of a kill during a start: files of dead runs are removed at the next
//! start, and a start can be killed at any point.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use joulebus_tests::{Arena, Child, PATIENCE, ReaderLine, Setup, Spread, eventually, figure};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

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

fn check<'a>(report: &'a Value, name: &str) -> &'a Value {
    let checks = report["checks"].as_array().expect("checks");
    checks.iter().find(|check| check["name"] == name).expect(name)
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
fn row_18_doctor_lists_stale_files_and_removes_them_only_on_request() {
    let arena = Arena::new(&Setup::default());
    killed_fleet(&arena);
    let before = arena.stale_files();
    let listed = arena.run(&["doctor", "--format", "json"]).json();
    assert_eq!(arena.stale_files(), before, "doctor changed files");
    let found = check(&listed, "stale files");
    assert_ne!(found["status"], "ok", "{listed}");
    let text = found["found"].as_str().unwrap();
    assert!(text.contains(&format!("{} objects", before.len() - 1)), "{text} {before:?}");
    assert!(found["remedy"].as_str().unwrap().contains("--fix"), "{listed}");

    let ended = arena.run(&["doctor", "--fix", "--format", "json"]);
    assert_eq!(ended.code(), Some(0), "{ended:?}");
    let mended = ended.json();
    assert_ne!(mended["mended"].as_array().map_or(0, Vec::len), 0, "{mended}");
    assert_eq!(check(&mended, "stale files")["status"], "ok", "{mended}");
    assert_eq!(arena.stale_files(), Vec::<std::path::PathBuf>::new());
    works(&arena, 0);
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

/// A kind of process: how to start it, and how to detect that it has joined.
struct Joiner {
    name: &'static str,
    command: fn(&Arena) -> Command,
    is_ready: fn(&mut Child) -> bool,
}

const JOINERS: [Joiner; 3] = [
    Joiner {
        name: "worker",
        command: Arena::worker_command,
        is_ready: |child| child.try_wait_for_line("ready:", PATIENCE).is_some(),
    },
    Joiner {
        name: "source",
        command: |arena| arena.probe(&["source", "victim"]),
        is_ready: |child| !child.lines(0, PATIENCE).is_empty(),
    },
    Joiner {
        name: "planner",
        command: |arena| arena.probe(&["planner"]),
        is_ready: |child| !child.lines(0, PATIENCE).is_empty(),
    },
];

/// `strace` with `options` on the joiner; its pid is written to `pid_file`.
fn traced(arena: &Arena, joiner: &Joiner, options: &[&str]) -> Child {
    let inner = (joiner.command)(arena);
    let mut command = Command::new("strace");
    command.args(["-f", "-qq"]).args(options).arg(inner.get_program()).args(inner.get_args());
    Child::spawn(joiner.name, command)
}

fn kill_traced(strace: &Child) {
    let path = format!("/proc/{0}/task/{0}/children", strace.pid());
    for pid in fs::read_to_string(path).unwrap_or_default().split_whitespace() {
        if let Some(pid) = pid.parse().ok().and_then(Pid::from_raw) {
            // It may have exited; its parent, strace, has not reaped it then.
            let _ = kill_process(pid, Signal::KILL);
        }
    }
}

/// Every system call of a start in order: its name and its index among calls of that name in its
/// thread.
fn points(arena: &Arena, joiner: &Joiner) -> Vec<(String, u32)> {
    let log = arena.files().join(format!("{}.strace", joiner.name));
    let mut strace = traced(arena, joiner, &["-o", &log.display().to_string()]);
    assert!((joiner.is_ready)(&mut strace), "{}", strace.tail());
    kill_traced(&strace);
    strace.wait();
    let (mut counts, mut seen) = (HashMap::<(String, String), u32>::new(), HashSet::new());
    let mut points = Vec::new();
    let text = fs::read(&log).expect("strace has written it");
    for line in String::from_utf8_lossy(&text).lines() {
        let mut words = line.split_whitespace();
        let (Some(thread), Some(rest)) = (words.next(), words.next()) else {
            continue;
        };
        let Some((call, _)) = rest.split_once('(') else {
            continue;
        };
        if call.is_empty() || call.starts_with('<') || call == "exit_group" {
            continue;
        }
        let count = counts.entry((thread.to_owned(), call.to_owned())).or_default();
        *count += 1;
        if seen.insert((call.to_owned(), *count)) {
            points.push((call.to_owned(), *count));
        }
    }
    points
}

/// Kills joiners at points spread evenly over their start; after each kill, a start must succeed.
fn killed_while_joining(name: &str, somebody_lives: bool) {
    let works_here = Command::new("strace").args(["-qq", "-e", "trace=none", "true"]).output();
    if !works_here.is_ok_and(|output| output.status.success()) {
        println!("skipped: needs strace with the right to trace");
        return;
    }
    // Number of kill points per joiner: an integer, or all.
    let wanted = std::env::var("JOULEBUS_CRASH_POINTS").unwrap_or_else(|_| "5".to_owned());
    let wanted: usize = wanted.parse().unwrap_or(usize::MAX);
    let arena = Arena::new(&Setup::default());
    let mut living = somebody_lives.then(|| {
        let controller = arena.controller("living", 90, 2, 60.0);
        assert!(!controller.lines(0, PATIENCE).is_empty());
        (controller, arena.planner())
    });
    let (mut killed, mut passed, mut total, mut again) = (0, 0, 0, 0);
    let (mut ready, mut disturbed) = (Spread::default(), 0);
    for joiner in &JOINERS {
        let points = points(&arena, joiner);
        works(&arena, 0);
        total += points.len();
        let step = (points.len() / wanted).max(1);
        for (call, number) in points.iter().skip(step / 2).step_by(step) {
            let trace = format!("trace={call}");
            let inject = format!("inject={call}:signal=SIGKILL:when={number}");
            let mut victim =
                traced(&arena, joiner, &["-e", &trace, "-e", &inject, "-o", "/dev/null"]);
            // Threads interleave differently: some points are not reached. Then it is killed
            // afterwards.
            if (joiner.is_ready)(&mut victim) {
                kill_traced(&victim);
                passed += 1;
            }
            victim.wait();
            killed += 1;
            println!("{} killed at {call} {number}", joiner.name);
            let (elapsed, log) = works(&arena, 10);
            ready.add(elapsed);
            again += log.matches("creating a node again").count();
            again += log.matches("opening a service again").count();
        }
    }
    if let Some((mut controller, mut planner)) = living.take() {
        assert!(controller.is_running(), "{}", controller.tail());
        assert!(planner.child.is_running(), "{}", planner.child.tail());
        let mut worker = arena.worker();
        let pid = worker.pid();
        planner.forecast("running processes continue", |frame| {
            (frame.pid == pid && frame.robot(90).is_some()).then_some(())
        });
        let is_failure = |line: &&ReaderLine| matches!(line, ReaderLine::Failed(_));
        disturbed += planner.seen().iter().filter(is_failure).count();
        let lines = controller.finish().stdout;
        disturbed += lines.iter().filter(|line| line.contains("Failed")).count();
        planner.leave();
        worker.stop();
    }
    figure(
        &format!("traps 11 and 12, {name}, bad crash points"),
        format_args!(
            "0 of {killed} of {total} system calls ({passed} not reached); then ready: {ready}; \
             {again} attempts to join repeated, {disturbed} passing failures of the living"
        ),
    );
}

#[test]
fn trap_11_after_a_kill_at_any_call_of_a_start_without_other_processes_the_next_start_works() {
    killed_while_joining("nobody alive", false);
}

#[test]
fn trap_12_after_a_kill_at_any_call_of_a_start_with_other_processes_the_next_start_works() {
    killed_while_joining("others alive", true);
}
