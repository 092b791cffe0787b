//! A calm fleet of a thousand robots, with a recorder, a live view and a planner. Memory,
//! descriptors, shared memory and files stay as they are. For hours:
//!
//! ```sh
//! JOULEBUS_SOAK_S=28800 cargo test -p joulebus-tests --test system soak -- --nocapture
//! ```
//!
//! With `JOULEBUS_SOAK_SERVE=target/debug/joulebus-serve` also its page and a stream.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use joulebus_bus::inspect;
use joulebus_tests::{Arena, Child, Dice, ReaderLine, Setup, eventually, figure};

const ROBOTS: &str = "1000";
/// Interval of splitting captures, s. Only the newest closed ones are kept, as by a timer.
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

/// Interval of printing what is held in a run of hours.
const PRINT_EVERY: Duration = Duration::from_secs(600);

/// Resources of a fleet's processes.
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
    words.into_iter().find_map(|word| word.parse().ok()).unwrap()
}

fn files_in(folder: &Path) -> usize {
    fs::read_dir(folder).map_or(0, Iterator::count)
}

impl Held {
    fn new(arena: &Arena, members: &[&Child]) -> Self {
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
                .map(|path| path.metadata().map_or(0, |metadata| metadata.len()))
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

/// The server of the page, if the caller names its program, and the thread that reads a stream.
fn page(arena: &Arena) -> Option<(Child, JoinHandle<usize>)> {
    let program = std::env::var_os("JOULEBUS_SOAK_SERVE")?;
    let mut command = Command::new(program);
    command.args(["--http", "127.0.0.1:0", "--config"]);
    command.arg(arena.config());
    let mut server = Child::spawn("serve", command);
    let line = server.wait_for_line("serving fleet");
    let address = line.rsplit('/').next().unwrap().to_owned();
    let mut stream = TcpStream::connect(&address).unwrap();
    let path = "/api/v1/stream?count=50&robot=1&hz=10";
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    let browser = std::thread::spawn(move || {
        let (mut bytes, mut read) = ([0; 1 << 16], 0);
        while let Ok(more @ 1..) = stream.read(&mut bytes) {
            read += more;
        }
        read
    });
    Some((server, browser))
}

/// Waits until the worker has taken a second of samples, by a planner of its own.
fn wait_until_all_send(arena: &Arena, source: &mut Child) {
    let mut planner = arena.consumer();
    planner.until_beside(source, "a thousand robots send", |line| match line {
        ReaderLine::Given { accepted, .. } => (*accepted > 20_000).then_some(()),
        _ => None,
    });
    planner.leave();
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
    wait_until_all_send(&arena, &mut source);
    // Hours of its lines would fill the test's memory.
    let mut planner = Child::spawn_unread("consumer", arena.probe(&["consumer"]));
    let has_joined = |pid: u32| {
        let found = inspect(arena.domain());
        found.is_ok_and(|found| found.nodes.iter().any(|node| node.pid == Some(pid)))
    };
    eventually("those that are not read have joined", || {
        has_joined(view.pid()) && has_joined(planner.pid())
    });
    let page = page(&arena);
    // The first quarter fills buffers.
    let (begin, length) = (Instant::now(), Duration::from_secs(seconds));
    let (mut first, mut last) = (None, None);
    let mut print_at = begin + PRINT_EVERY;
    while begin.elapsed() < length {
        std::thread::sleep(Duration::from_millis(500));
        remove_old(&arena);
        let mut members = vec![&worker, &recorder, &view, &source, &planner];
        members.extend(page.as_ref().map(|(server, _)| server));
        let held = Held::new(&arena, &members);
        if begin.elapsed() > length / 4 {
            first.get_or_insert(held.clone());
        }
        if Instant::now() > print_at {
            print_at += PRINT_EVERY;
            figure("soak, held", format_args!("{:?} {held:?}", begin.elapsed()));
        }
        last = Some(held);
    }
    let (first, last) = (first.unwrap(), last.unwrap());
    source.stop();
    view.end();
    planner.finish();
    if let Some((mut server, browser)) = page {
        assert_eq!(server.end().code(), Some(0));
        let read = browser.join().unwrap();
        figure("soak, the page", format_args!("{read} bytes streamed"));
        assert!(read > 0);
    }
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
        assert!(*after <= allowed, "{before} then {after} descriptors, allowed {allowed}");
    }
    assert!(last.files <= first.files + KEPT, "{} then {} files", first.files, last.files);
    for (place, (before, after)) in first.memory_kb.iter().zip(&last.memory_kb).enumerate() {
        let allowed = match place {
            RECORDER => RECORDER_KB,
            _ => before + SLACK_KB,
        };
        assert!(*after <= allowed, "{before} then {after} kB, allowed {allowed}");
    }
}
