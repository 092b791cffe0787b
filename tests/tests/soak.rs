//! A calm fleet of a thousand robots, with a recorder, a live view and a planner: memory, descriptors, shared memory and
//! files stay as they are. For hours, `JOULEBUS_SOAK_S=28800 cargo test -p joulebus-tests --test soak -- --nocapture`.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use joulebus_tests::{Arena, Child, Dice, ReaderLine, Setup, figure};

const ROBOTS: &str = "1000";
/// Captures are split so often, s; of closed ones the newest are kept, as an operator's timer would.
const SPLIT_S: &str = "4";
const KEPT: usize = 3;
/// Growth over the run that is no leak: allocators and page tables settle, kB a process.
const SLACK_KB: i64 = 4_096;
/// Most of the recorder: its queue is full where it waits for a CPU or the disk, kB.
const RECORDER_KB: i64 = 256 << 10;
/// Descriptors that are open for a moment: the ledger while it is saved, the lock while it is read.
const BRIEFLY_OPEN: usize = 4;
/// Place of the recorder among the processes.
const RECORDER: usize = 1;

/// What the processes of a fleet hold.
#[derive(Debug, Clone)]
struct Held {
    /// Resident memory of each process without shared memory and files, kB.
    memory_kb: Vec<i64>,
    descriptors: Vec<usize>,
    /// Objects in shared memory and their bytes.
    objects: usize,
    bytes: u64,
    files: usize,
}

/// A number of a line of /proc/PID/status.
fn status(pid: u32, name: &str) -> i64 {
    let text = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix(name));
    let words = line.unwrap().split_whitespace();
    words
        .into_iter()
        .find_map(|word| word.parse().ok())
        .unwrap()
}

fn files_in(folder: &Path) -> usize {
    fs::read_dir(folder).map_or(0, Iterator::count)
}

impl Held {
    fn of(arena: &Arena, members: &[&Child]) -> Self {
        let pids: Vec<u32> = members.iter().map(|child| child.pid()).collect();
        let objects = arena.stale_files();
        Self {
            memory_kb: pids.iter().map(|pid| status(*pid, "RssAnon:")).collect(),
            descriptors: pids
                .iter()
                .map(|pid| files_in(Path::new(&format!("/proc/{pid}/fd"))))
                .collect(),
            objects: objects.len(),
            bytes: objects
                .iter()
                .map(|path| path.metadata().map_or(0, |it| it.len()))
                .sum(),
            files: files_in(arena.files()),
        }
    }
}

/// Removes all but the newest parts of a capture.
fn remove_old(arena: &Arena) {
    let captures = fs::read_dir(arena.files()).unwrap().flatten();
    let mut parts: Vec<_> = captures
        .filter(|entry| entry.path().extension().is_some_and(|end| end == "mcap"))
        .map(|entry| (entry.metadata().unwrap().modified().unwrap(), entry.path()))
        .collect();
    parts.sort();
    for (_, path) in parts.iter().rev().skip(KEPT) {
        fs::remove_file(path).unwrap();
    }
}

#[test]
fn a_fleet_that_runs_for_long_holds_what_it_held_at_the_beginning() {
    let arena = Arena::new(&Setup {
        capacity: 1_000,
        robots: "0-999",
        tick_hz: 30.0,
        rate_hz: 30.0,
        stale_after_s: 10.0,
        buffer_frames: 64,
        ledger: true,
        ..Setup::default()
    });
    let seconds = Dice::rounds("JOULEBUS_SOAK_S", 12);
    let mut worker = arena.worker();
    let capture = arena.files().join("soak.mcap");
    let mut recorder = arena.recording(&capture, &["--max-bag-duration", SPLIT_S]);
    let mut view = Child::spawn_unread("watch", arena.command(&["watch", "--format", "json"]));
    let simulation = ["publish", "sim", "--seed", "7", "--robots", ROBOTS];
    let mut source = Child::spawn("simulation", arena.command(&simulation));
    let mut planner = arena.consumer();
    let all = |line: &ReaderLine| match line {
        ReaderLine::Given { accepted, .. } => (*accepted > 20_000).then_some(()),
        _ => None,
    };
    planner.until_beside(&mut source, "a thousand robots send", all);
    // The first quarter fills buffers.
    let (begin, length) = (Instant::now(), Duration::from_secs(seconds));
    let mut first = None;
    let mut last = None;
    while begin.elapsed() < length {
        std::thread::sleep(Duration::from_millis(500));
        remove_old(&arena);
        // The planner's pipe is read, so that it does not wait for the test.
        let _ = planner.seen().len();
        let held = Held::of(
            &arena,
            &[&worker, &recorder, &view, &source, &planner.child],
        );
        if begin.elapsed() > length / 4 {
            first.get_or_insert(held.clone());
        }
        last = Some(held);
    }
    let (first, last) = (first.unwrap(), last.unwrap());
    source.stop();
    view.end();
    planner.leave();
    let recorded = recorder.end();
    assert!(matches!(recorded.code(), Some(0 | 3)), "{recorded:?}");
    let report = worker.stop().json();
    figure(
        "soak",
        format_args!(
            "{seconds} s, 1,000 robots, {} ticks; first quarter {first:?}",
            report["ticks"]
        ),
    );
    figure("soak, at the end", format_args!("{last:?}"));
    let objects = |held: &Held| (held.objects, held.bytes);
    assert_eq!(objects(&first), objects(&last));
    for (before, after) in first.descriptors.iter().zip(&last.descriptors) {
        let allowed = before + BRIEFLY_OPEN;
        assert!(
            *after <= allowed,
            "{before} then {after} descriptors, allowed {allowed}"
        );
    }
    assert!(
        last.files <= first.files + KEPT,
        "{} then {} files",
        first.files,
        last.files
    );
    for (place, (before, after)) in first.memory_kb.iter().zip(&last.memory_kb).enumerate() {
        let allowed = match place {
            RECORDER => RECORDER_KB,
            _ => before + SLACK_KB,
        };
        assert!(
            *after <= allowed,
            "{before} then {after} kB, allowed {allowed}"
        );
    }
    arena.close();
}
