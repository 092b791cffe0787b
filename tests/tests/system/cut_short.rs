//! Processes of one user trust each other: any of them can truncate an object in shared memory, and
//! accesses to the missing part raise SIGBUS. Guaranteed is that restarts by a supervisor recover
//! the fleet.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use joulebus_tests::{Arena, Child, PATIENCE, ReaderLine, Setup, Spread, figure};

const SIGBUS: i32 = 7;

/// Command of each process of the fleet.
type Start = fn(&Arena) -> Child;

const TASKS: [(&str, Start); 3] = [
    ("worker", Arena::spawn_worker),
    ("controller", |arena| arena.controller("fleet", 0, 4, 30.0)),
    ("planner", |arena| Child::spawn("planner", arena.probe(&["planner"]))),
];

/// Restarts processes after a delay, and counts how they ended.
struct Supervisor {
    running: BTreeMap<&'static str, Child>,
    by_signal: u64,
    by_error: u64,
}

impl Supervisor {
    fn start(arena: &Arena) -> Self {
        Self {
            running: TASKS.iter().map(|(name, start)| (*name, start(arena))).collect(),
            by_signal: 0,
            by_error: 0,
        }
    }

    fn poll(&mut self, arena: &Arena) {
        for (name, start) in TASKS {
            let child = self.running.get_mut(name).expect("every task runs");
            // A controller that is notified of removed files ends in production; this one
            // continues.
            let is_reported = child.lines(0, Duration::ZERO).last().is_some_and(|line| {
                name == "controller" && line.contains("while this process used it")
            });
            if is_reported {
                child.end();
            }
            if child.is_running() {
                continue;
            }
            let ended = child.wait();
            if ended.signal() == Some(SIGBUS) {
                self.by_signal += 1;
            } else {
                self.by_error += 1;
            }
            std::thread::sleep(Duration::from_millis(100));
            self.running.insert(name, start(arena));
        }
    }

    /// Waits until the current planner has a forecast of a robot from the current worker.
    fn until_it_works(&mut self, arena: &Arena, what: &str) -> Duration {
        let begin = Instant::now();
        loop {
            self.poll(arena);
            let pid = self.running["worker"].pid();
            let lines = self.running["planner"].lines(0, Duration::ZERO);
            // The last line may be truncated if the process was killed.
            let newest = lines.iter().rev().take(4);
            let works = newest
                .filter_map(|line| serde_json::from_str::<ReaderLine>(line).ok())
                .any(|line| match line {
                    ReaderLine::Forecasts(frame) => frame.pid == pid && frame.robot(3).is_some(),
                    _ => false,
                });
            if works {
                return begin.elapsed();
            }
            assert!(begin.elapsed() < PATIENCE, "{what}: {:?}", self.running);
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

fn objects(arena: &Arena, end: &str) -> Vec<PathBuf> {
    let is_object = |path: &PathBuf| path.parent() == Some(Path::new("/dev/shm")) && path.is_file();
    let objects = arena.stale_files().into_iter().filter(is_object);
    objects.filter(|path| path.to_string_lossy().ends_with(end)).collect()
}

#[test]
fn after_truncation_of_an_object_restarts_recover_the_fleet() {
    let arena = Arena::new(&Setup::default());
    let (mut cured, mut killed, mut ended) = (Spread::default(), 0, 0);
    for end in [".data", ".dynamic", ".connection", ".event_mgmt", ""] {
        for length in [0, 4_096] {
            let what = format!("all *{end} cut to {length} bytes");
            let mut fleet = Supervisor::start(&arena);
            fleet.until_it_works(&arena, &what);
            for object in objects(&arena, end) {
                if let Ok(file) = fs::OpenOptions::new().write(true).open(&object)
                    && file.metadata().is_ok_and(|found| found.len() > length)
                {
                    file.set_len(length).unwrap();
                }
            }
            // Its users detect it at their next frame; then all processes must recover.
            std::thread::sleep(Duration::from_millis(600));
            let took = fleet.until_it_works(&arena, &what);
            println!("{what}: {took:?}");
            cured.add(took);
            killed += fleet.by_signal;
            ended += fleet.by_error;
            for child in fleet.running.values_mut() {
                child.end();
            }
            let swept = arena.run(&["doctor", "--fix"]);
            assert!(swept.code().is_some(), "{what}: {swept:?}");
            assert_eq!(arena.stale_files(), Vec::<PathBuf>::new(), "{what}");
        }
    }
    figure(
        "objects cut short by a process of the same user",
        format_args!(
            "10 ways: {killed} processes died by SIGBUS, {ended} ended by themselves; 0.6 s later the fleet works after {cured}"
        ),
    );
}
