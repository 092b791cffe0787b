//! Messages to a service manager: systemd's `Type=notify` and `WatchdogSec=`.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use rustix::process::Signal;

use crate::fleet::{Exits as _, Fleet, Program, code, stdout};

const TIMEOUT: Duration = Duration::from_secs(60);

/// The next message that is not `WATCHDOG=1`, and how many of those came before it.
fn next(socket: &UnixDatagram) -> (String, usize) {
    let mut bytes = [0; 4_096];
    let mut pings = 0;
    loop {
        let len = socket.recv(&mut bytes).expect("a message in time");
        let text = String::from_utf8_lossy(&bytes[..len]).into_owned();
        if text.trim() != "WATCHDOG=1" {
            return (text, pings);
        }
        pings += 1;
    }
}

fn ping(socket: &UnixDatagram) -> bool {
    let mut bytes = [0; 4_096];
    matches!(socket.recv(&mut bytes), Ok(len) if bytes[..len].starts_with(b"WATCHDOG=1"))
}

fn run(fleet: &Fleet, socket: &Path, watchdog: bool) -> Program {
    let mut command = fleet.joulebus("run --format json");
    command.env("NOTIFY_SOCKET", socket);
    command.env_remove("WATCHDOG_PID");
    if watchdog {
        command.env("WATCHDOG_USEC", "300000");
    } else {
        command.env_remove("WATCHDOG_USEC");
    }
    Program::start(command)
}

#[test]
fn a_service_manager_learns_when_the_worker_is_ready_works_and_ends() {
    let fleet = Fleet::new();
    let path = fleet.path("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut worker = run(&fleet, &path, true);
    let (first, _) = next(&socket);
    assert!(first.contains("READY=1") && first.contains("STATUS=ready: fleet cli"), "{first:?}");
    assert!(ping(&socket) && ping(&socket), "it works");
    // A stopped worker is silent: systemd would restart it.
    worker.signal(Signal::STOP);
    socket.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    while ping(&socket) {}
    socket.set_read_timeout(Some(TIMEOUT)).unwrap();
    worker.signal(Signal::CONT);
    assert!(ping(&socket), "it works again");
    worker.end(Signal::TERM).exits(0);
    assert_eq!(next(&socket).0.trim(), "STOPPING=1");
}

#[test]
fn without_a_watchdog_only_ready_and_the_end_are_notified() {
    let fleet = Fleet::new();
    let path = fleet.path("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut worker = run(&fleet, &path, false);
    assert!(next(&socket).0.contains("READY=1"));
    worker.wait_for_stderr("ready:");
    assert_eq!(code(&worker.end(Signal::INT)), 0);
    let (last, pings) = next(&socket);
    assert_eq!((last.trim(), pings), ("STOPPING=1", 0));
}

#[test]
fn every_verb_has_a_manual_page() {
    let fleet = Fleet::new();
    let folder = fleet.path("man1");
    let written = crate::fleet::output(["man", folder.to_str().unwrap()]);
    assert_eq!((code(&written), stdout(&written).as_str()), (0, ""));
    for page in [
        "joulebus.1",
        "joulebus-run.1",
        "joulebus-publish-sim.1",
        "joulebus-alarms.1",
        "joulebus-lab.1",
        "joulebus-train-trials.1",
    ] {
        let text = std::fs::read_to_string(folder.join(page)).unwrap();
        assert!(text.contains(".SH NAME") && text.contains(".SH OPTIONS"), "{page}: {text}");
    }
    for page in std::fs::read_dir(&folder).unwrap() {
        let page = page.unwrap().path();
        let text = std::fs::read_to_string(&page).unwrap();
        assert!(text.contains("\n  joulebus "), "{}: no example", page.display());
    }
}

/// The units, and their maximum exposure by `systemd-analyze security`, in tenths of a point of 10.
const UNITS: [(&str, u32); 4] = [
    ("joulebus@.service", 12),
    ("joulebus-record@.service", 12),
    // These two have the loopback address.
    ("joulebus-bridge@.service", 18),
    ("joulebus-serve@.service", 18),
];

#[test]
fn the_units_expose_little() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/systemd"));
    for (unit, most) in UNITS {
        let path = folder.join(unit);
        let analyzed = Command::new("systemd-analyze")
            .args(["security", "--offline=yes", &format!("--threshold={most}")])
            .arg(&path)
            .output();
        let Ok(analyzed) = analyzed else {
            let why = "systemd-analyze is not installed";
            assert!(std::env::var("CI").as_deref() != Ok("true"), "{why}");
            return println!("skipped: {why}");
        };
        assert!(analyzed.status.success(), "{unit}: {}", stdout(&analyzed));
        let text = std::fs::read_to_string(&path).unwrap();
        let start = text.lines().find_map(|line| line.strip_prefix("ExecStart=/usr/bin/"));
        // The verb and its options exist.
        let mut words = start.unwrap().split(' ');
        let verb = match words.next().unwrap() {
            "joulebus" => words.next().unwrap(),
            program => program.strip_prefix("joulebus-").unwrap(),
        };
        let help = stdout(&crate::fleet::output([verb, "--help"]));
        for option in words.filter(|word| word.starts_with("--")) {
            assert!(help.contains(option), "{unit}: {verb} {option}");
        }
    }
}
