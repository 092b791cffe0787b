//! The live view in a pseudo-terminal: real programs, a terminal's keys, and the resulting screen.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::num::NonZeroU16;
use std::os::fd::AsFd as _;
use std::process::{Child, Command, ExitStatus};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use joulebus_testkit::eventually;
use pty_process::Size;
use pty_process::blocking::Pty;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, kill_process};

use crate::fleet::{Fleet, Program, code, joulebus};

const DOWN: &str = "\x1b[B";
const ENTER: &str = "\r";
const ESCAPE: &str = "\x1b";

/// A program in a terminal of its own.
struct Terminal {
    pty: Option<Pty>,
    child: Child,
    parser: Arc<Mutex<vt100::Parser>>,
    is_closing: Arc<AtomicBool>,
    reader: Option<JoinHandle<Vec<u8>>>,
}

impl Terminal {
    fn start(command: Command, columns: u16, lines: u16) -> Self {
        let (pty, pts) = pty_process::blocking::open().unwrap();
        pty.resize(Size::new(lines, columns)).unwrap();
        let command = pty_process::blocking::Command::from(command);
        let child = command.env("TERM", "xterm-256color").spawn(pts).unwrap();
        let parser = Arc::new(Mutex::new(parser(columns, lines)));
        let is_closing = Arc::new(AtomicBool::new(false));
        let from = File::from(pty.as_fd().try_clone_to_owned().unwrap());
        let (inside, closing) = (Arc::clone(&parser), Arc::clone(&is_closing));
        let reader = std::thread::spawn(move || read(from, &inside, &closing));
        Self { pty: Some(pty), child, parser, is_closing, reader: Some(reader) }
    }

    fn press(&mut self, keys: &str) {
        let pty = self.pty.as_mut().unwrap();
        pty.write_all(keys.as_bytes()).unwrap();
    }

    fn resize(&mut self, columns: u16, lines: u16) {
        // A screen for the old size is no test of the new one.
        *self.parser.lock().unwrap() = parser(columns.max(10), lines.max(3));
        let pty = self.pty.as_ref().unwrap();
        pty.resize(Size::new(lines, columns)).unwrap();
    }

    fn lines(&self) -> Vec<String> {
        let parser = self.parser.lock().unwrap();
        let (_, columns) = parser.screen().size();
        parser.screen().rows(0, columns.get()).collect()
    }

    /// Waits until the screen fulfils `condition`, and returns it.
    fn shows(&self, what: &str, condition: impl Fn(&[String]) -> bool) -> Vec<String> {
        let mut lines = Vec::new();
        let begin = std::time::Instant::now();
        eventually(what, || {
            lines = self.lines();
            let holds = condition(&lines);
            let is_late = begin.elapsed() > joulebus_testkit::PATIENCE / 2;
            assert!(holds || !is_late, "{what}:\n{}", lines.join("\n"));
            holds
        });
        lines
    }

    fn shows_text(&self, text: &str) -> Vec<String> {
        self.shows(text, |lines| lines.iter().any(|line| line.contains(text)))
    }

    /// Closes the terminal, as a window or a connection is closed.
    fn hang_up(&mut self) -> Vec<u8> {
        self.is_closing.store(true, Ordering::Relaxed);
        let written = self.reader.take().unwrap().join().unwrap();
        self.pty = None;
        written
    }

    fn wait(&mut self) -> ExitStatus {
        let mut status = None;
        eventually("the program ends", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        status.unwrap()
    }

    /// Waits for the end, and that the terminal is as before.
    fn ends_well(mut self) {
        let status = self.wait();
        assert_eq!(status.code(), Some(0), "{:#?}", self.lines());
        let is_restored = |terminal: &Self| {
            let parser = terminal.parser.lock().unwrap();
            !parser.screen().alternate_screen() && !parser.screen().hide_cursor()
        };
        eventually("the terminal is restored", || is_restored(&self));
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.is_closing.store(true, Ordering::Relaxed);
    }
}

fn parser(columns: u16, lines: u16) -> vt100::Parser {
    let [columns, lines] = [columns, lines].map(|size| NonZeroU16::new(size).unwrap());
    vt100::Parser::new(lines, columns, 0)
}

/// Shows what the program writes until the terminal is closed; returns its last output.
fn read(mut from: File, parser: &Mutex<vt100::Parser>, is_closing: &AtomicBool) -> Vec<u8> {
    let mut buffer = [0; 1 << 14];
    let mut last = Vec::new();
    let patience = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };
    while !is_closing.load(Ordering::Relaxed) {
        let mut polled = [PollFd::new(&from, PollFlags::IN)];
        if poll(&mut polled, Some(&patience)).unwrap_or(0) == 0 {
            continue;
        }
        // An error once nobody has the other end open.
        let Ok(read @ 1..) = from.read(&mut buffer) else {
            break;
        };
        parser.lock().unwrap().process(&buffer[..read]);
        last = buffer[..read].to_vec();
    }
    last
}

/// The ids in the table, from above.
fn listed(lines: &[String]) -> Vec<u32> {
    let words = lines.iter().map(|line| line.trim_start_matches('│').trim_start());
    let first = words.filter_map(|line| {
        let (id, rest) = line.split_once(' ')?;
        rest.starts_with(|quality: char| quality.is_ascii_lowercase() || quality == '✗')
            .then(|| id.parse().ok())?
    });
    first.collect()
}

/// A worker, and six robots, of which the sensor of robot 2 is stuck.
fn running() -> (Fleet, Program, Program) {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let source = fleet.joulebus("publish sim --robots 6 --fault 2=stuck --format json");
    (fleet, worker, Program::start(source))
}

fn end(fleet: &Fleet, worker: Program, source: Program) {
    assert_eq!(code(&source.end(Signal::TERM)), 0);
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn keys_sort_filter_and_explain_at_three_sizes() {
    let (fleet, worker, source) = running();
    for (columns, lines) in [(60, 20), (80, 24), (120, 40)] {
        let mut terminal = Terminal::start(fleet.joulebus("watch"), columns, lines);
        // The alarm's name is whole. A frame may come in pieces: the table is its end.
        let shown = terminal.shows("the alarm and all robots", |lines| {
            let is_live = lines[0].contains("● live");
            is_live && lines.concat().contains("StuckSensor") && listed(lines).len() == 6
        });
        assert!(shown[0].contains("fleet cli  6 robots"), "{shown:#?}");
        assert!(shown.iter().all(|line| !line.contains("╮╭──╮")), "{shown:#?}");

        terminal.press("?");
        terminal.shows_text("sort by urgency, name, battery, power");
        terminal.press(" ");
        terminal.shows("the help is gone", |lines| {
            !lines.concat().contains("sort by urgency") && listed(lines).len() == 6
        });

        terminal.shows("the alarm is first", |lines| {
            listed(lines).first() == Some(&2) && lines.concat().contains("by urgency ↑")
        });
        terminal.press("s");
        terminal.shows("all by name", |lines| listed(lines) == [0, 1, 2, 3, 4, 5]);
        terminal.press("ss");
        terminal.shows_text("by power ↑");
        terminal.press("ssr");
        terminal.shows("the other way round", |lines| listed(lines) == [5, 4, 3, 2, 1, 0]);
        terminal.press("f");
        terminal.shows("only alarms", |lines| listed(lines) == [2]);
        terminal.press("f");
        terminal.press("/");
        terminal.press("gter");
        terminal.shows_text("search: gter");
        terminal.press(ENTER);
        terminal.shows_text("6 of 6: \"gter\"");
        terminal.press("/");
        for _ in 0..4 {
            terminal.press("\x7f");
        }
        terminal.press("stuck");
        terminal.press(ENTER);
        terminal.shows("the stuck one", |lines| listed(lines) == [2]);
        terminal.press(ESCAPE);
        terminal.shows("all again", |lines| listed(lines).len() == 6);
        terminal.press(DOWN);
        terminal.press("q");
        terminal.ends_well();
    }
    end(&fleet, worker, source);
}

#[test]
fn the_view_follows_a_terminal_that_changes_its_size() {
    let (fleet, worker, source) = running();
    let mut terminal = Terminal::start(fleet.joulebus("watch --robot 2"), 120, 40);
    terminal.shows_text("robot 2 ━ reading");
    for (columns, lines, text) in [
        (60, 20, "fleet cli  6 robots"),
        (10, 3, "● live"),
        // Too small to be parsed: vt100 overflows. The next size shows that the view lives.
        (3, 1, ""),
        (1, 1, ""),
        (250, 80, "robot 2 ━ reading"),
        (80, 24, "robot 2 ━ read ━ forecast"),
    ] {
        terminal.resize(columns, lines);
        terminal.shows_text(text);
        // Keys work at every size. No Escape: with the next key it would be that key with Alt.
        terminal.press("sfrf/2\x7f");
        terminal.press(ENTER);
    }
    terminal.press("\x03");
    terminal.ends_well();
    end(&fleet, worker, source);
}

#[test]
fn a_view_whose_terminal_goes_away_ends() {
    let (fleet, worker, source) = running();
    let mut terminal = Terminal::start(fleet.joulebus("watch"), 80, 24);
    terminal.shows_text("● live");
    terminal.hang_up();
    assert_eq!(terminal.wait().code(), Some(0));
    end(&fleet, worker, source);
}

#[test]
fn a_view_goes_on_after_the_begin_of_a_key_and_ends_at_a_signal() {
    let (fleet, worker, source) = running();
    // Alt-O, and a paste without its end.
    for begin in ["\x1bO", "\x1b[200~"] {
        let mut terminal = Terminal::start(fleet.joulebus("watch"), 80, 24);
        terminal.shows_text("● live");
        terminal.press(begin);
        terminal.resize(100, 30);
        terminal.shows_text("● live");
        kill_process(Pid::from_child(&terminal.child), Signal::TERM).unwrap();
        terminal.ends_well();
    }
    end(&fleet, worker, source);
}

#[test]
fn a_demo_of_80_columns_is_readable_and_ends_with_its_report() {
    // Longer than any machine takes for the keys.
    let demo = joulebus("demo --robots 8 --no-capture --duration 3600".split(' '));
    let mut terminal = Terminal::start(demo, 80, 24);
    terminal.shows_text("fleet demo  8 robots");
    terminal.shows("robots are listed", |lines| {
        lines[0].contains("● live") && !listed(lines).is_empty()
    });
    terminal.press("?");
    terminal.shows_text("the other way round");
    terminal.press(ESCAPE);
    terminal.shows("the help is gone", |lines| !lines.concat().contains("the other way round"));
    terminal.press("q");
    // The robots' alarms are on the screen as before.
    terminal.ends_well();
}

#[test]
fn a_demo_whose_terminal_goes_away_ends_its_processes() {
    let demo = joulebus("demo --robots 4 --no-capture --duration 3600".split(' '));
    let mut terminal = Terminal::start(demo, 80, 24);
    terminal.shows_text("fleet demo  4 robots");
    let demo = terminal.child.id();
    let before = children(demo).len();
    assert!(before > 2, "{before}");
    terminal.hang_up();
    let status = terminal.wait();
    // Nobody can read its report: 1.
    assert!(matches!(status.code(), Some(0 | 1)), "{status:?}");
    eventually("its processes end", || children(demo).is_empty());
}

/// Processes of the session of `leader`.
fn children(leader: u32) -> Vec<u32> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let ids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    ids.filter(|id| {
        let Ok(stat) = std::fs::read_to_string(format!("/proc/{id}/stat")) else {
            return false;
        };
        // After the name: state, parent, group, session.
        let rest = stat.rsplit_once(") ").map_or("", |(_, rest)| rest);
        rest.split(' ').nth(3) == Some(leader.to_string().as_str())
    })
    .collect()
}
