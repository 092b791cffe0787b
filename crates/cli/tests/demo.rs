//! The demonstration and the view, as real processes: they add up, they end, they leave nothing.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use joulebus_bus::Domain;
use joulebus_config::Demo as DemoConfig;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// What has not happened after so long never will.
const PATIENCE: Duration = Duration::from_secs(180);

/// A run of the program; killed if the test ends before it does.
struct Run {
    process: Child,
    stdout: Option<JoinHandle<String>>,
    stderr: Receiver<String>,
    said: Vec<String>,
}

impl Run {
    fn start(arguments: &[&str]) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_joulebus"))
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut out = process.stdout.take().unwrap();
        let stdout = std::thread::spawn(move || {
            let mut text = String::new();
            out.read_to_string(&mut text).unwrap();
            text
        });
        let err = BufReader::new(process.stderr.take().unwrap());
        let (say, stderr) = channel();
        std::thread::spawn(move || {
            for line in err.lines().map_while(Result::ok) {
                let _ = say.send(line);
            }
        });
        Self {
            process,
            stdout: Some(stdout),
            stderr,
            said: Vec::new(),
        }
    }

    fn demo(arguments: &[&str]) -> Self {
        let mut all = vec!["demo", "--format", "json"];
        // Demonstrations run next to each other here: only who asks for it leaves a capture.
        if !arguments.contains(&"--capture") {
            all.push("--no-capture");
        }
        all.extend(arguments);
        Self::start(&all)
    }

    fn root(&self) -> PathBuf {
        let root = Domain::default_root().display().to_string();
        PathBuf::from(format!("{root}-demo-{}", self.process.id()))
    }

    /// What the demonstration has left.
    fn stale_files(&self) -> Vec<PathBuf> {
        let root = self.root();
        let domain = Domain::new("demo", &root, "jbd_").unwrap();
        stale_files(&domain)
    }

    /// What follows `text` in the first line on stderr, from now on, that has it.
    fn wait_for(&mut self, text: &str) -> String {
        let give_up = Instant::now() + PATIENCE;
        loop {
            match self.stderr.recv_timeout(Duration::from_millis(100)) {
                Ok(line) => {
                    self.said.push(line.clone());
                    if let Some((_, rest)) = line.split_once(text) {
                        return rest.to_owned();
                    }
                }
                Err(RecvTimeoutError::Timeout) if Instant::now() < give_up => {}
                Err(_) => panic!("{text:?} does not come: {:#?}", self.said),
            }
        }
    }

    /// The pid of one of the demonstration's processes.
    fn pid_of(&mut self, name: &str) -> u32 {
        self.wait_for(&format!("{name} runs as process "))
            .parse()
            .unwrap()
    }

    /// Until workers have accepted more than so many samples, by the lines on the way; how many.
    fn wait_for_samples(&mut self, more_than: u64) -> u64 {
        loop {
            let told = self.wait_for("  samples ");
            let (samples, _) = told.split_once(' ').unwrap();
            let samples = samples.parse().unwrap();
            if samples > more_than {
                return samples;
            }
        }
    }

    fn signal(&self, signal: Signal) {
        send(self.process.id(), signal);
    }

    fn end(&mut self) -> (ExitStatus, String) {
        let status = self.wait();
        let stdout = self.stdout.take().unwrap().join().unwrap();
        // Its end may come before its last words.
        self.said.extend(self.stderr.iter());
        (status, stdout)
    }

    /// The exit status, waited for with patience.
    fn wait(&mut self) -> ExitStatus {
        let give_up = Instant::now() + PATIENCE;
        while Instant::now() < give_up {
            if let Some(status) = self.process.try_wait().unwrap() {
                return status;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("does not end: {:#?}", self.said);
    }

    /// Exit code and summary of a demonstration.
    fn summary(&mut self) -> (i32, Value) {
        let (status, stdout) = self.end();
        let code = status
            .code()
            .unwrap_or_else(|| panic!("{status}: {:#?}", self.said));
        let summary = serde_json::from_str(&stdout);
        (
            code,
            summary.unwrap_or_else(|error| panic!("{error}: {stdout} {:#?}", self.said)),
        )
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn send(pid: u32, signal: Signal) {
    let pid = Pid::from_raw(i32::try_from(pid).unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

/// Whether the process is over; a zombie that nobody waits for is.
fn is_over(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.is_empty() || stat.contains(") Z ")
}

fn stale_files(domain: &Domain) -> Vec<PathBuf> {
    let objects = fs::read_dir("/dev/shm").unwrap().flatten();
    objects
        .filter(|entry| {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            name.starts_with(domain.shm_prefix()) || entry.path() == domain.root()
        })
        .map(|entry| entry.path())
        .collect()
}

fn count(value: &Value) -> u64 {
    value
        .as_u64()
        .unwrap_or_else(|| panic!("{value} is no count"))
}

fn dropped(summary: &Value) -> u64 {
    let reasons = summary["samples"]["dropped"].as_object().unwrap();
    reasons.values().map(count).sum()
}

fn assert_nothing_left(summary: &Value, demo: &Run) {
    assert_eq!(count(&summary["left_behind"]["objects"]), 0);
    assert_eq!(count(&summary["left_behind"]["nodes"]), 0);
    assert_eq!(demo.stale_files(), Vec::<PathBuf>::new());
}

#[test]
fn it_adds_up_and_leaves_nothing() {
    let mut demo = Run::demo(&["--duration", "3", "--robots", "5"]);
    let (code, summary) = demo.summary();
    assert_eq!(code, 0, "{summary:#}");
    let samples = &summary["samples"];
    let sent = count(&samples["sent"]);
    // 90 frames of five robots, less what a busy machine makes the source pass over.
    assert!(
        (5..=5 * 95).contains(&sent) && sent.is_multiple_of(5),
        "{sent}"
    );
    assert_eq!(sent, count(&samples["accepted"]) + dropped(&summary));
    assert_eq!(samples["difference"], 0);
    assert_eq!(samples["lost_between_workers"], 0);
    assert_eq!(summary["adds_up"], true);
    assert_eq!(count(&summary["robots"]), 5);
    assert_eq!(count(&summary["workers"]), 1);
    assert!(count(&summary["ticks"]["done"]) > 0);
    let latency = &summary["planner"]["latency"];
    let frames = count(&latency["total"]["count"]);
    assert!(frames > 0);
    for stage in [
        "sent_to_taken",
        "taken_to_compute",
        "compute",
        "compute_to_sent",
        "sent_to_readable",
    ] {
        assert_eq!(count(&latency[stage]["count"]), frames, "{stage}");
        let max_us = latency[stage]["max_us"].as_f64().unwrap();
        assert!(
            max_us <= latency["total"]["max_us"].as_f64().unwrap() * 1.001,
            "{stage}"
        );
    }
    assert!(summary["scores"]["mae_w"].as_f64().unwrap() > 0.0);
    assert!(summary["scores"]["persistence_r2"].as_f64().unwrap() <= 1.0);
    let planted = summary["stand_out"].as_array().unwrap().len()
        + summary["unnoticed"].as_array().unwrap().len();
    assert!(planted >= 2, "{summary:#}");
    assert_nothing_left(&summary, &demo);
}

#[test]
fn it_leaves_a_capture_of_all_that_was_sent() {
    let directory = tempfile::tempdir().unwrap();
    let run = |attempt: u32| {
        let file = directory.path().join(format!("{attempt}.mcap"));
        let arguments = ["--duration", "3", "--robots", "5", "--capture"];
        let mut demo = Run::demo(&[&arguments[..], &[file.to_str().unwrap()]].concat());
        let (code, summary) = demo.summary();
        assert_eq!(code, 0, "{summary:#}");
        assert_eq!(summary["capture"]["path"], file.to_str().unwrap());
        let is_whole = count(&summary["capture"]["messages_lost"]) == 0;
        is_whole.then_some((file, demo, summary))
    };
    // A recorder that waits too long for a processor loses messages, and says so.
    let whole = (0..5).find_map(run);
    let (file, demo, summary) = whole.expect("the recorder lost messages each time");
    let mut samples = 0;
    let mut messages = 0;
    for entry in joulebus_capture::Reader::open(&file).unwrap() {
        messages += 1;
        if let joulebus_capture::Message::Samples(_, rows) = entry.unwrap().message {
            samples += rows.len() as u64;
        }
    }
    assert_eq!(samples, count(&summary["samples"]["sent"]));
    assert_eq!(messages, count(&summary["capture"]["messages"]));
    assert_nothing_left(&summary, &demo);
}

#[test]
fn signals_end_it_with_a_summary_of_what_there_was() {
    for signal in [Signal::INT, Signal::TERM, Signal::HUP] {
        let mut demo = Run::demo(&["--duration", "600", "--robots", "3"]);
        demo.wait_for_samples(0);
        demo.signal(signal);
        let (code, summary) = demo.summary();
        assert_eq!(code, 0, "{signal:?}: {summary:#}");
        assert_eq!(summary["adds_up"], true, "{signal:?}");
        assert!(count(&summary["samples"]["accepted"]) > 0, "{signal:?}");
        assert_nothing_left(&summary, &demo);
    }
}

#[test]
fn a_signal_at_any_moment_of_the_start_leaves_nothing() {
    for after_ms in [0, 5, 20, 60, 120, 250] {
        let mut demo = Run::demo(&["--duration", "600", "--robots", "3"]);
        std::thread::sleep(Duration::from_millis(after_ms));
        // Not SIGINT: where that is ignored from the start (a shell's background job), a signal that
        // comes before the handler would be lost.
        demo.signal(Signal::TERM);
        let (status, _) = demo.end();
        // Before the handler is there, the signal kills: then nothing was begun or said yet.
        let early = status.signal() == Some(15) && demo.said.is_empty();
        assert!(
            status.success() || early,
            "{after_ms} ms: {status} {:#?}",
            demo.said
        );
        assert_eq!(demo.stale_files(), Vec::<PathBuf>::new(), "{after_ms} ms");
    }
}

#[test]
fn a_killed_worker_is_restarted_and_the_summary_adds_up() {
    let mut demo = Run::demo(&["--duration", "600", "--robots", "4"]);
    let worker = demo.pid_of("worker");
    let samples = demo.wait_for_samples(0);
    send(worker, Signal::KILL);
    assert_ne!(demo.pid_of("worker"), worker);
    demo.wait_for_samples(samples);
    demo.signal(Signal::TERM);
    let (code, summary) = demo.summary();
    assert_eq!(code, 0, "{summary:#}");
    assert_eq!(count(&summary["workers"]), 2, "{summary:#}");
    let samples = &summary["samples"];
    let told = count(&samples["accepted"]) + dropped(&summary);
    let lost = count(&samples["lost_between_workers"]);
    assert_eq!(count(&samples["sent"]), told + lost);
    // The rest before the restart alone is longer than two frames.
    assert!(lost >= 4, "{summary:#}");
    let deaths = summary["deaths"].as_array().unwrap();
    assert!(
        deaths[0].as_str().unwrap().contains("again in 100 ms"),
        "{deaths:?}"
    );
    assert_nothing_left(&summary, &demo);
}

#[test]
fn a_killed_source_is_restarted_and_the_summary_adds_up() {
    let mut demo = Run::demo(&["--duration", "600", "--robots", "4"]);
    let source = demo.pid_of("source");
    let samples = demo.wait_for_samples(0);
    send(source, Signal::KILL);
    assert_ne!(demo.pid_of("source"), source);
    demo.wait_for_samples(samples);
    demo.signal(Signal::TERM);
    let (code, summary) = demo.summary();
    assert_eq!(code, 0, "{summary:#}");
    assert_eq!(summary["adds_up"], true);
    // One frame may have died with the source, unseen.
    assert_eq!(count(&summary["samples"]["uncertain"]), 4);
    assert_nothing_left(&summary, &demo);
}

#[test]
fn killed_itself_its_processes_end_and_the_next_run_cleans_up() {
    let mut demo = Run::demo(&["--duration", "600", "--robots", "3"]);
    let children = [
        demo.pid_of("worker"),
        demo.pid_of("planner"),
        demo.pid_of("source"),
    ];
    demo.wait_for_samples(0);
    demo.signal(Signal::KILL);
    demo.wait();
    let give_up = Instant::now() + PATIENCE;
    while !children.into_iter().all(is_over) {
        assert!(Instant::now() < give_up, "{children:?} go on");
        std::thread::sleep(Duration::from_millis(20));
    }
    let mut next = Run::demo(&["--duration", "0.5", "--robots", "1"]);
    let (code, summary) = next.summary();
    assert_eq!(code, 0, "{summary:#}");
    assert_nothing_left(&summary, &next);
    assert_eq!(demo.stale_files(), Vec::<PathBuf>::new());
}

/// A fleet of its own.
struct Arena {
    domain: Domain,
    directory: tempfile::TempDir,
}

impl Arena {
    fn new(robots: u32) -> Self {
        let directory = tempfile::Builder::new()
            .prefix("jbw")
            .tempdir_in("/dev/shm")
            .unwrap();
        let config = DemoConfig {
            fleet: "w".to_owned(),
            root: directory.path().join("r"),
            prefix: "jbw_".to_owned(),
            robots,
        };
        fs::write(directory.path().join("fleet.toml"), config.toml()).unwrap();
        Self {
            domain: Domain::new("w", &config.root, "jbw_").unwrap(),
            directory,
        }
    }

    fn config(&self) -> &Path {
        self.directory.path()
    }

    fn program(&self, arguments: &[&str]) -> Run {
        let config = self.config().join("fleet.toml").display().to_string();
        let mut all = arguments.to_vec();
        all.extend(["--config", &config]);
        Run::start(&all)
    }
}

fn frames(lines: &str) -> Vec<Value> {
    lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn watch_without_a_worker_says_what_to_do() {
    let arena = Arena::new(2);
    let mut watch = arena.program(&["watch", "--once"]);
    watch.wait_for("no worker serves fleet w");
    assert_eq!(watch.wait().code(), Some(1));
    assert_eq!(stale_files(&arena.domain), Vec::<PathBuf>::new());
}

#[test]
fn watch_may_begin_before_the_worker_and_goes_on_with_the_next_one() {
    let arena = Arena::new(2);
    let mut watch = arena.program(&["watch", "--format", "json"]);
    watch.wait_for("waiting for a worker");
    let mut source = arena.program(&["publish", "sim", "--robots", "2"]);
    for _ in 0..2 {
        let mut worker = arena.program(&["run"]);
        let pid = worker.process.id();
        watch.wait_for(&format!("worker {pid} serves"));
        worker.signal(Signal::KILL);
        worker.wait();
        watch.wait_for(&format!("worker {pid} is gone"));
    }
    let mut worker = arena.program(&["run"]);
    let pid = worker.process.id();
    watch.wait_for(&format!("worker {pid} serves"));
    // It gives up after three seconds, in which a busy machine may not come so far.
    let give_up = Instant::now() + PATIENCE;
    let stdout = loop {
        let mut once = arena.program(&["watch", "--once", "--robot", "1", "--format", "json"]);
        let (status, stdout) = once.end();
        if status.success() {
            break stdout;
        }
        assert!(Instant::now() < give_up, "{:#?}", once.said);
    };
    let frame: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(frame["worker_pid"], pid);
    assert_eq!(frame["robots"].as_array().unwrap().len(), 1);
    assert_eq!(frame["robots"][0]["robot"], 1);
    for run in [&mut source, &mut worker, &mut watch] {
        run.signal(Signal::TERM);
        assert!(run.wait().success());
    }
    let frames = frames(&watch.end().1);
    let mut epochs: Vec<u64> = frames
        .iter()
        .map(|frame| count(&frame["worker_epoch"]))
        .collect();
    epochs.dedup();
    assert_eq!(epochs.len(), 3, "{epochs:?}");
    assert!(frames.windows(2).all(|pair| {
        pair[0]["worker_epoch"] != pair[1]["worker_epoch"]
            || count(&pair[0]["tick"]) < count(&pair[1]["tick"])
    }));
    assert_eq!(stale_files(&arena.domain), Vec::<PathBuf>::new());
}
