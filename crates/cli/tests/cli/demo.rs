//! `joulebus demo` and `watch` as real processes: the counts add up, they stop, they leave no
//! files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::RwLockReadGuard;
use std::time::Duration;

use joulebus_bus::Domain;
use joulebus_config::{Demo as DemoConfig, default_root};
use joulebus_testkit::{Child, end_signals, eventually, left_behind};
use joulebus_wire::Samples;
use rustix::fs::{FlockOperation, flock};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

struct Run(
    Child,
    #[expect(dead_code, reason = "held while the demonstration lives")]
    Option<RwLockReadGuard<'static, ()>>,
);

impl Run {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus"));
        command.args(arguments);
        let seen = (arguments[0] == "demo").then(crate::fleet::seen);
        Self(Child::spawn(arguments[0], command), seen)
    }

    fn demo(arguments: &[&str]) -> Self {
        let mut all = vec!["demo", "--format", "json"];
        // Demonstrations run in parallel here: only those that ask for it write a capture.
        if !arguments.contains(&"--capture") {
            all.push("--no-capture");
        }
        all.extend(arguments);
        Self::start(&all)
    }

    fn root(&self) -> PathBuf {
        let root = default_root().display().to_string();
        PathBuf::from(format!("{root}-demo-{}", self.0.pid()))
    }

    /// Remaining files of the demonstration.
    fn stale_files(&self) -> Vec<PathBuf> {
        let root = self.root();
        let domain = Domain::new("demo", &root, "jbd_").unwrap();
        left_behind(domain.shm_prefix(), domain.root())
    }

    /// Waits for the next stderr line that contains `text`; returns the rest of the line.
    fn wait_for(&mut self, text: &str) -> String {
        let line = self.0.wait_for_line(text);
        line.split_once(text).unwrap().1.to_owned()
    }

    /// Pid of a process of the demonstration.
    fn pid_of(&mut self, name: &str) -> u32 {
        self.wait_for(&format!("{name} runs as process ")).parse().unwrap()
    }

    /// Waits until workers have accepted more than `more_than` samples, by the progress lines;
    /// returns their number.
    fn wait_for_samples(&mut self, more_than: u64) -> u64 {
        loop {
            let line = self.wait_for("  samples ");
            let (samples, _) = line.split_once(' ').unwrap();
            let samples = samples.parse().unwrap();
            if samples > more_than {
                return samples;
            }
        }
    }

    /// Exit code and summary of a demonstration.
    fn summary(&mut self) -> (i32, Value) {
        let ended = self.0.wait();
        let code = ended.code().unwrap_or_else(|| panic!("{ended:?}"));
        (code, ended.json())
    }
}

fn send(pid: u32, signal: Signal) {
    let pid = Pid::from_raw(i32::try_from(pid).unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

/// True if the process has exited. A zombie holds its locks until its other threads have exited.
fn is_over(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let threads = fs::read_dir(format!("/proc/{pid}/task")).map_or(0, Iterator::count);
    stat.is_empty() || stat.contains(") Z ") && threads <= 1
}

fn count(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is not a count"))
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
fn counts_add_up_and_no_files_are_left() {
    let run = |_| {
        let mut demo = Run::demo(&["--duration", "3", "--robots", "5"]);
        let (code, summary) = demo.summary();
        assert_eq!(code, 0, "{summary:#}");
        let read = &summary["planner"]["latency"]["total"]["count"];
        let is_seen = read.as_u64() > Some(0) && summary["scores"]["mae_w"].is_number();
        is_seen.then_some((demo, summary))
    };
    // Retries where a process got no processor for most of the three seconds.
    let (demo, summary) = (0..5).find_map(run).expect("no forecast was scored");
    let samples = &summary["samples"];
    let sent = count(&samples["sent"]);
    // 90 frames of five robots, minus those that the source skips on a busy machine.
    assert!((5..=5 * 95).contains(&sent) && sent.is_multiple_of(5), "{sent}");
    assert_eq!(sent, count(&samples["accepted"]) + dropped(&summary));
    assert_eq!(samples["difference"], 0);
    assert_eq!(summary["adds_up"], true);
    assert_eq!(count(&summary["robots"]), 5);
    assert!(count(&summary["ticks"]["done"]) > 0);
    let latency = &summary["planner"]["latency"];
    let frames = count(&latency["total"]["count"]);
    assert!(frames > 0);
    for stage in
        ["sent_to_taken", "taken_to_compute", "compute", "compute_to_sent", "sent_to_readable"]
    {
        assert_eq!(count(&latency[stage]["count"]), frames, "{stage}");
        let max_us = latency[stage]["max_us"].as_f64().unwrap();
        assert!(max_us <= latency["total"]["max_us"].as_f64().unwrap() * 1.001, "{stage}");
    }
    assert!(summary["scores"]["mae_w"].as_f64().unwrap() > 0.0);
    assert!(summary["scores"]["persistence_r2"].as_f64().unwrap() <= 1.0);
    let planted = summary["stand_out"].as_array().unwrap().len()
        + summary["unnoticed"].as_array().unwrap().len();
    assert!(planted >= 2, "{summary:#}");
    assert_nothing_left(&summary, &demo);
}

#[test]
fn the_capture_contains_all_samples_sent() {
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
    // A recorder that gets no processor in time loses messages and reports it.
    let whole = (0..5).find_map(run);
    let (file, demo, summary) = whole.expect("the recorder lost messages each time");
    let mut samples = 0;
    let mut messages = 0;
    for entry in joulebus_capture_format::Reader::open(&file).unwrap() {
        messages += 1;
        let frame = entry.unwrap().message.into_frame::<Samples>();
        samples += frame.map_or(0, |frame| frame.rows.len() as u64);
    }
    assert_eq!(samples, count(&summary["samples"]["sent"]));
    assert_eq!(messages, count(&summary["capture"]["messages"]));
    assert_nothing_left(&summary, &demo);
}

#[test]
fn a_signal_stops_it_with_a_summary() {
    for signal in end_signals() {
        let mut demo = Run::demo(&["--duration", "600", "--robots", "3"]);
        demo.wait_for_samples(0);
        demo.0.signal(signal);
        let (code, summary) = demo.summary();
        assert_eq!(code, 0, "{signal:?}: {summary:#}");
        assert_eq!(summary["adds_up"], true, "{signal:?}");
        assert!(count(&summary["samples"]["accepted"]) > 0, "{signal:?}");
        assert_nothing_left(&summary, &demo);
    }
}

#[test]
fn a_signal_at_any_time_during_the_start_leaves_no_files() {
    for after_ms in [0, 5, 20, 60, 120, 250] {
        let mut demo = Run::demo(&["--duration", "600", "--robots", "3"]);
        std::thread::sleep(Duration::from_millis(after_ms));
        // Not SIGINT: where it is ignored from the start (background job of a shell), a signal
        // before the handler is installed would be lost.
        demo.0.signal(Signal::TERM);
        let ended = demo.0.wait();
        // Before the handler is installed the signal kills: nothing has been created or printed
        // yet.
        let early = ended.signal() == Some(15) && ended.stderr.is_empty();
        assert!(ended.code() == Some(0) || early, "{after_ms} ms: {ended:?}");
        assert_eq!(demo.stale_files(), Vec::<PathBuf>::new(), "{after_ms} ms");
    }
}

#[test]
fn a_process_that_dies_ends_the_demo_is_named_and_leaves_no_files() {
    for name in ["worker", "planner", "source"] {
        let mut demo = Run::demo(&["--duration", "600", "--robots", "4"]);
        let pids = ["worker", "planner", "source"].map(|each| demo.pid_of(each));
        let place = ["worker", "planner", "source"].iter().position(|each| *each == name).unwrap();
        demo.wait_for_samples(0);
        send(pids[place], Signal::KILL);
        let ended = demo.0.wait();
        assert_eq!((ended.code(), ended.text().as_str()), (Some(1), ""), "{ended:?}");
        let named = format!("error: {name} (process {}) ended with signal: 9", pids[place]);
        assert!(ended.errors().contains(&named), "{name}: {ended:?}");
        assert!(pids.into_iter().all(is_over), "{name}");
        assert_eq!(demo.stale_files(), Vec::<PathBuf>::new(), "{name}");
    }
}

#[test]
fn after_sigkill_its_processes_exit_and_the_next_run_cleans_up() {
    let mut demo = Run::demo(&["--duration", "600", "--robots", "3"]);
    let children = [demo.pid_of("worker"), demo.pid_of("planner"), demo.pid_of("source")];
    demo.wait_for_samples(0);
    demo.0.signal(Signal::KILL);
    demo.0.wait();
    eventually("its processes have exited", || children.into_iter().all(is_over));
    // As a demo that looks at the same time, and found the processes alive.
    let looked_at = fs::File::open(demo.root().join("demo.toml"));
    if let Ok(config) = &looked_at {
        flock(config, FlockOperation::LockShared).unwrap();
    }
    let mut next = Run::demo(&["--duration", "0.5", "--robots", "1"]);
    let (code, summary) = next.summary();
    assert_eq!(code, 0, "{summary:#}");
    assert_nothing_left(&summary, &next);
    // Another test's demo may have come first, and be at it.
    eventually("the killed demo's files are removed", || demo.stale_files().is_empty());
}

struct Arena {
    domain: Domain,
    directory: tempfile::TempDir,
}

impl Arena {
    fn new(robots: u32) -> Self {
        let directory = tempfile::Builder::new().prefix("jbw").tempdir_in("/dev/shm").unwrap();
        let config = DemoConfig {
            fleet: "w".to_owned(),
            root: directory.path().join("r"),
            prefix: "jbw_".to_owned(),
            robots,
        };
        fs::write(directory.path().join("fleet.toml"), config.toml()).unwrap();
        Self { domain: Domain::new("w", &config.root, "jbw_").unwrap(), directory }
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
    lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn watch_without_a_worker_prints_a_hint() {
    let arena = Arena::new(2);
    let mut watch = arena.program(&["watch", "--once"]);
    watch.wait_for("no worker serves fleet w");
    assert_eq!(watch.0.wait().code(), Some(1));
    assert_eq!(left_behind(arena.domain.shm_prefix(), arena.domain.root()), Vec::<PathBuf>::new());
}

#[test]
fn watch_may_start_before_the_worker_and_continues_with_the_next_one() {
    let arena = Arena::new(2);
    let mut watch = arena.program(&["watch", "--format", "json"]);
    watch.wait_for("Waiting for one");
    let mut source = arena.program(&["publish", "sim", "--robots", "2"]);
    for _ in 0..2 {
        let mut worker = arena.program(&["run"]);
        let pid = worker.0.pid();
        watch.wait_for(&format!("worker {pid} serves"));
        worker.0.signal(Signal::KILL);
        worker.0.wait();
        watch.wait_for(&format!("worker {pid} is gone"));
    }
    let mut worker = arena.program(&["run"]);
    let pid = worker.0.pid();
    watch.wait_for(&format!("worker {pid} serves"));
    // It times out after three seconds, which may not be enough on a busy machine.
    let mut frame = Value::Null;
    eventually("the robot is there", || {
        let mut once = arena.program(&["watch", "--once", "--robot", "1", "--format", "json"]);
        let ended = once.0.wait();
        let is_there = ended.code() == Some(0);
        if is_there {
            frame = ended.json();
        }
        is_there
    });
    assert_eq!(frame["worker_pid"], pid);
    let model =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors");
    let mut info = crate::fleet::joulebus(["model", "info", model, "--format", "json"]);
    let info: Value = serde_json::from_slice(&info.output().unwrap().stdout).unwrap();
    assert_eq!(frame["model_hash"], info["model_hash"]);
    assert_eq!(frame["robots"].as_array().unwrap().len(), 1);
    assert_eq!(frame["robots"][0]["robot"], 1);
    for run in [&mut source, &mut worker, &mut watch] {
        run.0.stop();
    }
    let frames = frames(&watch.0.wait().text());
    let mut epochs: Vec<u64> = frames.iter().map(|frame| count(&frame["worker_epoch"])).collect();
    epochs.dedup();
    assert_eq!(epochs.len(), 3, "{epochs:?}");
    assert!(frames.windows(2).all(|pair| {
        pair[0]["worker_epoch"] != pair[1]["worker_epoch"]
            || count(&pair[0]["tick"]) < count(&pair[1]["tick"])
    }));
    assert_eq!(left_behind(arena.domain.shm_prefix(), arena.domain.root()), Vec::<PathBuf>::new());
}
