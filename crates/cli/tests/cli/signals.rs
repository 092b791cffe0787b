//! Signals that end a subcommand: each ends it cleanly and leaves no files.

use std::fs;
use std::io::{self, Read as _, Write as _};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use joulebus_testkit::{end_signals, eventually, ignores};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};

use crate::captures::capture;
use crate::exits::{calls, leaves, subcommands};
use crate::fleet::{Exits as _, Fleet, Program, at, code, joulebus, json, output, stderr, stdout};

/// Subcommands that go on until a signal, and a line that they print once they run. Their exit code
/// is 0, but for training: the model is not made, the checkpoint is. Words in capitals are files.
pub(crate) const RUNS: [(&str, &str); 17] = [
    ("demo --robots 2 --no-capture --format json", "  samples "),
    ("run --config FLEET", "ready:"),
    ("run --record FILE --config FLEET", "ready:"),
    ("record -o FILE --config FLEET", "recording cli into"),
    ("record --snapshot 5 -o FILE --config FLEET", "recording cli"),
    ("publish sim --robots 3 --config FLEET", "no worker serves fleet cli"),
    ("publish trial TRIAL@0 --loop --no-wait --config FLEET", "no worker serves fleet cli"),
    ("publish trial TRIAL@0 --config FLEET", "Waiting for one"),
    ("watch --plain --config FLEET", "Waiting for one"),
    ("watch --format json --config FLEET", "Waiting for one"),
    ("alarms --config FLEET", "alarms of fleet cli"),
    ("replay CAPTURE --config FLEET", "Waiting for one"),
    ("serve --http 127.0.0.1:0 --config FLEET", "serving fleet cli"),
    ("bridge BRIDGE --config FLEET", "bridging 1 robots"),
    ("link LINK --config FLEET", "is open"),
    ("train trials LONG --split time -o NEW", "epoch   1"),
    ("train sim --seed 1 -o NEW", "epoch   1"),
];

/// Subcommands that compute for a while, and leave only whole files: a signal ends them at once.
const COMPUTES: &[&str] = &[
    "data simulate NEW --steps 4000000",
    "mission --hours 24",
    "report --simulated -o NEW",
    "bench kernel",
];

/// Subcommands that end by themselves, at once or after reading their files. [`crate::exits`] has
/// their codes.
const ENDS: &str = "ask, battery, link init, info, recover, import, data info, data check, data convert, doctor, status, \
    config init, config check, config show, config explain, config schema, analyze, eval, \
    model info, model import, model export, model compare, completions, man, new";

/// The command of a row, with its input files created.
pub(crate) fn command(fleet: &Fleet, row: &str) -> Command {
    let file = |name: &str| -> PathBuf {
        match name {
            "FLEET" => fleet.config(),
            "FILE" => fleet.path("run.mcap"),
            "NEW" => fleet.path("new"),
            "TRIAL@0" => at(&fleet.recording("a.csv", 30), "0"),
            "LONG" => fleet.recording("long.csv", 20_000),
            "CAPTURE" => capture(fleet, 300).0,
            "BRIDGE" => bridge(fleet),
            "LINK" => link(fleet),
            word => PathBuf::from(word),
        }
    };
    joulebus(row.split_whitespace().map(file))
}

/// The file of a bridge to a broker that does not answer.
fn bridge(fleet: &Fleet) -> PathBuf {
    let path = fleet.path("bridge.toml");
    let text = "[robots]\nagv = 1\n[mqtt]\nbroker = \"127.0.0.1:1\"\n\
                [[mqtt.read]]\ntopic = \"{robot}/power\"\nfields = { power = { at = \"\" } }\n";
    fs::write(&path, text).unwrap();
    path
}

/// The file of a planners' host whose worker's host does not answer.
fn link(fleet: &Fleet) -> PathBuf {
    let path = fleet.path("link.toml");
    let text = "name = \"desk\"\n[network]\nconnect = [\"tcp/127.0.0.1:1\"]\n[follow]\nworker = \"base\"\n";
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn every_verb_that_runs_until_stopped_ends_cleanly_at_each_signal_with_its_code() {
    for (row, wanted) in RUNS.iter().filter(|(row, _)| crate::fleet::is_built(row)) {
        let expected = i32::from(row.starts_with("train"));
        for signal in end_signals() {
            let fleet = Fleet::new();
            let mut program = Program::start(command(&fleet, row));
            program.wait_for_stderr(wanted);
            let ended = program.end(signal);
            let printed = stderr(&ended);
            assert_eq!(code(&ended), expected, "{row}, {signal:?}: {printed}");
            assert!(fleet.stale_files().is_empty(), "{row}, {signal:?}");
            assert!(!fleet.path("new").exists(), "{row}, {signal:?}");
        }
    }
}

#[test]
fn a_signal_ends_what_writes_to_a_reader_that_takes_nothing() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 10"));
    for (verb, flags) in [
        ("watch --format json", OFlags::empty()),
        ("watch --format json", OFlags::NONBLOCK),
        ("record -o -", OFlags::NONBLOCK),
    ] {
        let (mut reader, writer) = io::pipe().unwrap();
        fcntl_setfl(&writer, flags).unwrap();
        let mut command = fleet.joulebus(verb);
        command.stdout(writer.try_clone().unwrap()).stderr(Stdio::null());
        let mut program = command.spawn().unwrap();
        drop(command);
        let is_full = || {
            let now = Timespec { tv_sec: 0, tv_nsec: 0 };
            poll(&mut [PollFd::new(&writer, PollFlags::OUT)], Some(&now)) == Ok(0)
        };
        eventually("the pipe is full", is_full);
        reader.read_exact(&mut [0; 1 << 15]).unwrap();
        eventually("it is full again", is_full);
        kill_process(Pid::from_child(&program), Signal::TERM).unwrap();
        let mut status = None;
        eventually("the program ends", || {
            status = program.try_wait().unwrap();
            status.is_some()
        });
        // 0 if the signal comes between two writes.
        assert!(matches!(status.unwrap().code(), Some(0 | 1)), "{verb}, {flags:?}: {status:?}");
    }
    assert_eq!(code(&source.end(Signal::TERM)), 0);
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
}

#[test]
fn a_worker_whose_log_nobody_reads_serves_and_ends_at_a_signal() {
    let fleet = Fleet::new();
    let (_reader, mut writer) = io::pipe().unwrap();
    fcntl_setfl(&writer, OFlags::NONBLOCK).unwrap();
    while writer.write(b"x").is_ok() {}
    fcntl_setfl(&writer, OFlags::empty()).unwrap();
    let mut command = fleet.joulebus("run");
    let mut worker = command.stdout(Stdio::null()).stderr(writer).spawn().unwrap();
    let mut watch = Program::start(fleet.joulebus("watch --format json"));
    watch.wait_for_stdout("\"tick\"");
    assert_eq!(code(&watch.end(Signal::TERM)), 0);
    kill_process(Pid::from_child(&worker), Signal::TERM).unwrap();
    let mut status = None;
    eventually("the worker ends", || {
        status = worker.try_wait().unwrap();
        status.is_some()
    });
    assert_eq!(status.unwrap().code(), Some(0));
}

#[test]
fn a_verb_that_ends_by_itself_waits_for_the_reader_of_its_errors() {
    let names: Vec<String> =
        (0..800).map(|number| format!("/nowhere/{number:0>100}.toml")).collect();
    let mut command = joulebus(["config", "check"]);
    command.args(&names).stdout(Stdio::null()).stderr(Stdio::piped());
    let checks = command.spawn().unwrap();
    // Longer than a fleet waits for whoever reads its log.
    std::thread::sleep(Duration::from_millis(500));
    let ended = checks.wait_with_output().unwrap();
    assert_eq!(code(&ended), 2);
    let said = stderr(&ended);
    assert!(names.iter().all(|name| said.contains(name.as_str())), "{said}");
    assert!(said.contains("800 of 800"), "{said}");
}

#[test]
fn a_signal_ends_what_computes_at_once_and_leaves_only_whole_files() {
    let (signals, ignored): (Vec<_>, Vec<_>) =
        end_signals().into_iter().partition(|signal| !ignores(std::process::id(), *signal));
    if !ignored.is_empty() {
        println!("skipped: {ignored:?} is ignored here, and by children that do not handle it");
    }
    for row in COMPUTES.iter().filter(|row| crate::fleet::is_built(row)) {
        for signal in signals.iter().copied() {
            let (fleet, ended) = interrupted(row, signal);
            let by = ended.status.signal();
            assert_eq!(by, Some(signal.as_raw()), "{row}: {}", stderr(&ended));
            for file in files_below(&fleet.path("new")) {
                // Written by rename, once it is whole.
                let checked = output([Path::new("data"), Path::new("check"), &file]);
                assert_eq!(code(&checked), 0, "{row}: {}", stdout(&checked));
            }
        }
    }
}

/// Runs a row until it computes, and ends it. Retries where it was done before this process looked.
fn interrupted(row: &str, signal: Signal) -> (Fleet, Output) {
    for _ in 0..20 {
        let fleet = Fleet::new();
        let program = Program::start(command(&fleet, row));
        std::thread::sleep(Duration::from_millis(300));
        if let Some(ended) = end_running(program, signal) {
            return (fleet, ended);
        }
    }
    panic!("{row} is done before any signal");
}

/// Sends a signal to a running program, and waits for its end. `None` if it was over before: it is
/// stopped first, to be sure.
fn end_running(mut program: Program, signal: Signal) -> Option<Output> {
    program.signal(Signal::STOP);
    let stat = format!("/proc/{}/stat", program.pid());
    let mut is_stopped = false;
    eventually("it is stopped or over", || {
        let stat = fs::read_to_string(&stat).unwrap_or_default();
        // After the name; one that has been waited for is not there.
        let state = stat.rsplit_once(") ").map_or("Z", |(_, rest)| rest);
        is_stopped = state.starts_with('T');
        is_stopped || state.starts_with('Z')
    });
    program.signal(signal);
    program.signal(Signal::CONT);
    let ended = program.wait();
    is_stopped.then_some(ended)
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths.filter(|path| path.is_file()).collect()
}

#[test]
fn each_verb_is_in_one_of_the_tables_of_what_signals_do() {
    let all = subcommands();
    for verb in &leaves() {
        let runs = RUNS.iter().any(|(row, _)| calls(row, verb));
        let computes = COMPUTES.iter().any(|row| calls(row, verb));
        let ends = ENDS.split(", ").any(|row| row == verb);
        let tables = [runs, computes, ends].into_iter().filter(|is| *is).count();
        assert_eq!(tables, 1, "{verb}: {runs} {computes} {ends}");
    }
    let runs = RUNS.iter().map(|(row, _)| *row);
    let rows = runs.chain(COMPUTES.iter().copied()).chain(ENDS.split(", "));
    for row in rows {
        // A verb may run by itself and have verbs, as `link` does.
        let is_listed = all.iter().any(|words| calls(row, &words.join(" ")));
        assert!(is_listed, "{row} is no verb");
    }
}

#[test]
fn a_process_started_with_nohup_outlives_its_terminal() {
    let fleet = Fleet::new();
    let run = fleet.joulebus("run");
    let mut nohup = Command::new("bash");
    nohup.args(["-c", "trap '' HUP; exec \"$@\"", "bash"]);
    nohup.arg(run.get_program()).args(run.get_args());
    let mut worker = Program::start(nohup);
    worker.wait_for_stderr("ready:");
    assert!(ignores(worker.pid(), Signal::HUP));
    worker.signal(Signal::HUP);
    let doctor = json(&fleet.output("doctor --format json"));
    let runs = format!("runs, pid {}", worker.pid());
    assert!(doctor["checks"].to_string().contains(&runs), "{doctor}");
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_snapshot_requested_together_with_the_end_is_written() {
    let fleet = Fleet::new();
    let file = fleet.path("asked.mcap");
    let worker = fleet.worker();
    let verb = format!("record --snapshot 60 --no-alarm --format json -o {}", file.display());
    let mut record = Program::start(fleet.joulebus(&verb));
    record.wait_for_stderr("recording cli into");
    fleet.output("publish sim --robots 3 --duration 0.5 --format json").exits(0);
    eventually("messages in memory", || {
        // Progress is printed every five seconds.
        record
            .printed()
            .iter()
            .any(|line| line.contains("in memory") && !line.contains(" 0 messages of"))
    });
    record.signal(Signal::USR1);
    let ended = record.end(Signal::TERM);
    // One that gets no processor for a quarter of a second loses messages, and reports that.
    assert!(matches!(code(&ended), 0 | 3), "{}", stderr(&ended));
    let report = json(&ended);
    assert_eq!(report["files"].as_array().unwrap().len(), 1, "{report}");
    assert!(report["messages"].as_u64().unwrap() > 0, "{report}");
    assert!(file.exists());
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    assert!(fleet.stale_files().is_empty());
}
