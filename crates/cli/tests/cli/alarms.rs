//! Raises and ends of alarms: live, passed to a command, and in a capture.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use joulebus_testkit::eventually;
use rustix::process::Signal;
use serde_json::Value;

use crate::fleet::{Exits as _, Fleet, Program, at, code, json, output, stderr, stdout};

const ROBOTS: usize = 3;

/// Lines that the command has written: robot, alarm and change.
fn hook_lines(path: &Path) -> Vec<String> {
    let text = fs::read_to_string(path).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

fn count(path: &Path, what: &str) -> usize {
    hook_lines(path).iter().filter(|line| line.ends_with(what)).count()
}

/// Waits until all robots are silent: the last report of them.
fn wait_for_silence(path: &Path) {
    eventually("all robots are silent", || {
        let lines = hook_lines(path);
        let is_silent = |robot: usize| {
            let of_robot = format!("{robot} NoData ");
            let last = lines.iter().rfind(|line| line.starts_with(&of_robot));
            last.is_some_and(|line| line.ends_with("raised"))
        };
        (0..ROBOTS).all(is_silent)
    });
}

fn publish(fleet: &Fleet) {
    fleet.output("publish sim --robots 3 --duration 1").exits(0);
}

#[test]
fn the_workers_log_has_one_line_for_an_alarm_of_many_robots() {
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    fleet.output("publish sim --robots 10 --duration 1").exits(0);
    worker.wait_for_stderr("alarm raised of 10 robots");
    let log = stderr(&worker.end(Signal::TERM).exits(0));
    let mut lines = log.lines().filter(|line| line.contains("NoData") && line.contains("raised"));
    assert!(lines.all(|line| line.contains("of 10 robots") && line.contains("0-9")), "{log}");
}

#[test]
fn every_change_is_shown_passed_to_the_command_and_found_in_the_capture() {
    let fleet = Fleet::new();
    let (hook, capture) = (fleet.path("told"), fleet.path("run.mcap"));
    let mut worker = fleet.worker();
    let mut record = fleet.joulebus("record --format json");
    let mut recorder = Program::start({
        record.arg("-o").arg(&capture);
        record
    });
    recorder.wait_for_stderr("recording");
    let mut watch = fleet.joulebus("alarms --format json");
    let command =
        format!("echo \"$JOULEBUS_ROBOT $JOULEBUS_ALARM $JOULEBUS_CHANGE\" >> {}", hook.display());
    let mut watcher = Program::start({
        watch.arg("--on-alarm").arg(command);
        watch
    });
    watcher.wait_for_stderr("alarms of fleet cli");
    // They fall silent, send again, and fall silent.
    publish(&fleet);
    wait_for_silence(&hook);
    publish(&fleet);
    eventually("they sent again", || count(&hook, "NoData cleared") >= ROBOTS);
    wait_for_silence(&hook);
    let cleared = count(&hook, "NoData cleared");
    let recorded = recorder.end(Signal::TERM);
    // One that gets no processor for a quarter of a second loses messages, and reports that.
    assert!(matches!(code(&recorded), 0 | 3), "{}", stderr(&recorded));
    worker.signal(Signal::KILL);
    eventually("its end is told", || count(&hook, "WorkerGone raised") == 1);
    drop(worker);
    let worker = fleet.worker();
    publish(&fleet);
    eventually("the next one is told", || count(&hook, "WorkerGone cleared") == 1);
    let watched = watcher.end(Signal::TERM);
    // A process that gets no processor for two seconds misses ticks, and reports that.
    let missed = stderr(&watched).contains("ticks without diagnostics");
    assert_eq!(code(&watched), if missed { 3 } else { 0 }, "{}", stderr(&watched));
    assert_eq!(code(&worker.end(Signal::TERM)), 0);

    let lines: Vec<Value> =
        stdout(&watched).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let shown = lines.iter().map(|line| {
        let robot = line["robot"].as_u64().map_or(String::new(), |id| id.to_string());
        let word = |name: &str| line[name].as_str().unwrap().to_owned();
        format!("{robot} {} {}", word("alarm"), word("change"))
    });
    assert_eq!(shown.collect::<Vec<_>>(), hook_lines(&hook));
    for line in &lines {
        assert_eq!(line["lasted_s"].is_null(), line["change"] == "raised", "{line}");
    }

    let history = output(["alarms", "--format", "json", capture.to_str().unwrap()]);
    let history = json(&history);
    let episodes = history["alarms"].as_array().unwrap();
    let silent: Vec<&Value> =
        episodes.iter().filter(|episode| episode["alarm"] == "NoData").collect();
    let robots: BTreeSet<u64> =
        silent.iter().filter_map(|episode| episode["robot"].as_u64()).collect();
    assert_eq!(robots.len(), ROBOTS, "{history}");
    let ended = |end: &str| silent.iter().filter(|episode| episode["end"] == end).count();
    assert_eq!((ended("cleared"), ended("raised")), (cleared, ROBOTS), "{history}");
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_command_that_fails_is_counted_and_the_changes_are_shown() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let mut watch = fleet.joulebus("alarms");
    let mut watcher = Program::start({
        watch.args(["--on-alarm", "exit 7"]);
        watch
    });
    watcher.wait_for_stderr("alarms of fleet cli");
    publish(&fleet);
    watcher.wait_for_stderr("--on-alarm: exit status: 7");
    // Not the first change where the worker gets no processor: that is `WorkerStale`.
    watcher.wait_for_stdout("NoData raised (stale)");
    let watched = watcher.end(Signal::INT);
    assert_eq!(code(&watched), 3, "{watched:?}");
    assert!(stderr(&watched).contains("were not taken by --on-alarm"));
    assert!(stdout(&watched).contains("NoData raised (stale)"), "{watched:?}");
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
}

#[test]
fn the_worker_logs_each_raise_and_each_end_and_its_report_counts_them() {
    let fleet = Fleet::new();
    let mut worker = Program::start(fleet.joulebus("run --format json --log-format json"));
    worker.wait_for_stderr("ready: fleet cli");
    publish(&fleet);
    worker.wait_for_stderr("\"alarm\":\"NoData\"");
    publish(&fleet);
    worker.wait_for_stderr("alarm ended");
    let ended = worker.end(Signal::TERM).exits(0);

    let lines: Vec<Value> = stderr(&ended)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    assert!(lines.iter().any(|line| line["target"] == "joulebus::program"));
    let alarms = lines.iter().filter(|line| line["target"] == "joulebus::alarms");
    let (raised, over): (Vec<&Value>, Vec<&Value>) =
        alarms.partition(|line| line["change"] == "raised");
    let silent = |robot: usize| {
        let is_it = |line: &&&Value| line["robot"] == robot && line["alarm"] == "NoData";
        raised.iter().filter(is_it).count()
    };
    for robot in 0..ROBOTS {
        assert!(silent(robot) >= 1, "robot {robot}: {lines:?}");
    }
    for line in &over {
        assert!(line["lasted_s"].as_f64().is_some_and(|s| s > 0.0), "{line}");
    }
    let report = json(&ended);
    assert_eq!(report["alarms"]["raised"], raised.len(), "{report}");
    assert_eq!(report["alarms"]["ended"], over.len(), "{report}");
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_reader_that_starts_later_shows_when_an_alarm_was_raised_and_so_does_the_next() {
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    publish(&fleet);
    for _ in 0..ROBOTS {
        worker.wait_for_stderr("NoData");
    }
    let unix_ns = || {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
        u64::try_from(since.as_nanos()).unwrap()
    };
    let raised_by_ns = unix_ns();
    std::thread::sleep(Duration::from_secs(2));
    let stamps_ns: Vec<u64> = (0..2)
        .map(|_| {
            let mut late = Program::start(fleet.joulebus("alarms --format json"));
            late.wait_for_stdout("\"robot\":1,\"alarm\":\"NoData\"");
            let lines = late.shown();
            let mut lines = lines.iter().map(|line| serde_json::from_str::<Value>(line).unwrap());
            let line = lines.find(|line| line["robot"] == 1 && line["alarm"] == "NoData");
            let line = line.unwrap();
            assert_eq!(line["change"], "raised", "{line}");
            late.end(Signal::TERM);
            line["stamp_ns"].as_u64().unwrap()
        })
        .collect();
    for stamp_ns in &stamps_ns {
        assert!(*stamp_ns <= raised_by_ns, "{stamps_ns:?}, raised before {raised_by_ns}");
        assert!(stamp_ns.abs_diff(stamps_ns[0]) < 1_000_000_000, "{stamps_ns:?}");
    }
    let mut watch = Program::start(fleet.joulebus("watch --plain"));
    watch.wait_for_stderr("robot 1: NoData, since ");
    watch.end(Signal::TERM);
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn an_alarm_is_explained_by_its_name_in_any_case() {
    let one = output(["alarms", "--explain", "levelhigh"]);
    assert_eq!(code(&one), 0, "{}", stderr(&one));
    let text = stdout(&one);
    for part in ["LevelHigh (warn)", "meaning", "check", "alarms.level_limit"] {
        assert!(text.contains(part), "{text}");
    }
    let all = json(&output(["alarms", "--format", "json", "--explain"]));
    let names: BTreeSet<&str> =
        all.as_array().unwrap().iter().map(|card| card["alarm"].as_str().unwrap()).collect();
    assert!(names.contains("NoData") && names.contains("WorkerGone"), "{names:?}");
    let unknown = output(["alarms", "--explain", "Bias"]);
    assert_eq!(code(&unknown), 2);
    assert!(stderr(&unknown).contains("BiasHigh"), "{}", stderr(&unknown));
}

/// Runs the verb, and returns its exit code and output.
fn acknowledge(fleet: &Fleet, arguments: &[&str]) -> (i32, String) {
    let mut command = fleet.joulebus("alarms");
    let ended = command.env("USER", "eve").arg("--acknowledge").args(arguments).output().unwrap();
    (code(&ended), stdout(&ended) + &stderr(&ended))
}

/// The changes of an alarm of robot 1 that the verb has shown so far, with the names of those who
/// acknowledged it.
fn of_robot_1(program: &mut Program, alarm: &str) -> Vec<String> {
    let lines = program.shown();
    let lines = lines.iter().map(|line| -> Value { serde_json::from_str(line).unwrap() });
    let of_it = lines.filter(|line| line["robot"] == 1 && line["alarm"] == alarm);
    let shown = of_it.map(|line| {
        let word = |of: &Value| of.as_str().unwrap_or("nobody").to_owned();
        format!("{} {}", word(&line["change"]), word(&line["acknowledged"]["by"]))
    });
    shown.collect()
}

#[test]
fn an_alarm_is_acknowledged_until_it_ends_and_the_capture_and_its_replay_state_by_whom() {
    let fleet = Fleet::new();
    let (_, none) = acknowledge(&fleet, &["1", "NoData"]);
    assert!(none.contains("no worker serves fleet cli"), "{none}");
    let worker = fleet.worker();
    let capture = fleet.path("run.mcap");
    let mut record = fleet.joulebus("record");
    record.arg("-o").arg(&capture);
    let mut recorder = Program::start(record);
    recorder.wait_for_stderr("recording");
    let mut watcher = Program::start(fleet.joulebus("alarms --format json"));
    watcher.wait_for_stderr("alarms of fleet cli");
    publish(&fleet);
    let ended_with = |program: &mut Program, expected: &[&str]| {
        eventually(&format!("{expected:?}"), || {
            of_robot_1(program, "NoData")
                .ends_with(&expected.iter().map(|end| (*end).to_owned()).collect::<Vec<_>>())
        });
    };
    ended_with(&mut watcher, &["raised nobody"]);

    let (status, printed) = acknowledge(&fleet, &["1", "nodata", "--by", "ann"]);
    assert_eq!((status, &*printed), (0, "robot 1: NoData acknowledged by ann\n"));
    let (status, printed) = acknowledge(&fleet, &["1", "BiasHigh", "--by", "ann"]);
    assert!(status == 1 && printed.contains("BiasHigh of robot 1 is not raised"), "{printed}");
    for (wrong, reason) in [
        (&["1", "WorkerGone"][..], "cannot be acknowledged"),
        (&["x", "NoData"], "no id of a robot"),
        (&["1", "Nothing"], "allowed: NoData"),
        (&["1"], "2 values"),
        (&["1", "NoData", "--by", "\n"], "control characters"),
        (&["1", "NoData", "--new-normal"], "allowed: LevelHigh, LevelLow"),
    ] {
        let (status, printed) = acknowledge(&fleet, wrong);
        assert!(status == 2 && printed.contains(reason), "{wrong:?}: {status} {printed}");
    }
    ended_with(&mut watcher, &["raised nobody", "acknowledged ann"]);
    // One that comes later is listed, too.
    let mut later = Program::start(fleet.joulebus("alarms --format json"));
    ended_with(&mut later, &["raised nobody", "acknowledged ann"]);
    publish(&fleet);
    for program in [&mut watcher, &mut later] {
        ended_with(program, &["acknowledged ann", "cleared ann", "raised nobody"]);
    }
    let mut last = Program::start(fleet.joulebus("alarms --format json"));
    ended_with(&mut last, &["raised nobody"]);
    for program in [watcher, later, last] {
        assert!(matches!(code(&program.end(Signal::TERM)), 0 | 3));
    }
    let recorded = recorder.end(Signal::TERM);
    assert!(matches!(code(&recorded), 0 | 3), "{}", stderr(&recorded));
    let report = json(&worker.end(Signal::TERM));
    assert_eq!(report["alarms"]["acknowledged"], 1, "{report}");

    let history = json(&output(["alarms", "--format", "json", capture.to_str().unwrap()]));
    let episodes = history["alarms"].as_array().unwrap().iter();
    let silent: Vec<&Value> =
        episodes.filter(|episode| episode["robot"] == 1 && episode["alarm"] == "NoData").collect();
    let (first, rest) = silent.split_first().unwrap();
    assert_eq!((&first["acknowledged"]["by"], &first["end"]), (&"ann".into(), &"cleared".into()));
    let after_ns = first["acknowledged"]["at_unix_ns"].as_u64() > first["raised_ns"].as_u64();
    assert!(after_ns && rest.iter().all(|episode| episode["acknowledged"].is_null()), "{history}");

    let mut watcher = Program::start(fleet.joulebus("alarms --format json"));
    watcher.wait_for_stderr("alarms of fleet cli");
    let mut replay = fleet.joulebus("replay");
    replay.arg(&capture).args(["--topics", "diagnostics", "forecasts", "acknowledgements"]);
    let played = replay.output().unwrap();
    assert_eq!(code(&played), 0, "{}", stderr(&played));
    ended_with(&mut watcher, &["cleared ann", "raised nobody"]);
    assert!(matches!(code(&watcher.end(Signal::TERM)), 0 | 3));
    let verified = output(["replay", "--verify", capture.to_str().unwrap()]);
    assert!(matches!(code(&verified), 0 | 3), "{}", stdout(&verified));
    assert!(fleet.stale_files().is_empty());
}

/// A recording of 20 minutes, with a load of 6 W after the first half minute.
fn loaded(fleet: &Fleet) -> PathBuf {
    let mut text = "timestamp_s,power_mW,v_cmd_mps,omega_cmd_radps\n".to_owned();
    for row in 0..36_000_u32 {
        let (time_s, step) = (f64::from(row) / 30.0, f64::from(row));
        let v = [0.05, 0.1, 0.15][row as usize / 60 % 3];
        let load_mw = if row < 900 { 0.0 } else { 6_000.0 };
        let power_mw = 3_000.0 + 4_000.0 * v + 60.0 * (0.7 * step).sin() + load_mw;
        text += &format!("{time_s:.4},{power_mw:.1},{v},0.1\n");
    }
    let path = fleet.path("loaded.csv");
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_load_that_is_the_new_normal_raises_no_alarm_any_more_and_its_tick_is_verified() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let capture = fleet.path("run.mcap");
    let mut recorder = Program::start({
        let mut record = fleet.joulebus("record");
        record.arg("-o").arg(&capture);
        record
    });
    recorder.wait_for_stderr("recording");
    let mut watcher = Program::start(fleet.joulebus("alarms --format json"));
    watcher.wait_for_stderr("alarms of fleet cli");
    // It follows the worker: no sample is lost on a busy machine.
    let mut source = fleet.joulebus("publish trial --rate 10");
    source.arg(at(&loaded(&fleet), "1"));
    let source = Program::start(source);
    let shown = |program: &mut Program, expected: &[&str]| {
        eventually(&format!("{expected:?}"), || of_robot_1(program, "LevelHigh") == expected);
    };
    shown(&mut watcher, &["raised nobody"]);
    let (status, printed) = acknowledge(&fleet, &["1", "LevelHigh", "--new-normal", "--by", "ann"]);
    assert_eq!(
        (status, &*printed),
        (0, "robot 1: LevelHigh acknowledged as the new normal by ann\n")
    );
    // The load goes on.
    shown(&mut watcher, &["raised nobody", "acknowledged ann", "cleared ann"]);
    let (status, printed) = acknowledge(&fleet, &["1", "LevelHigh", "--new-normal", "--by", "ann"]);
    assert!(status == 1 && printed.contains("is not raised"), "{printed}");
    source.end(Signal::TERM);
    assert!(matches!(code(&watcher.end(Signal::TERM)), 0 | 3));
    assert!(matches!(code(&recorder.end(Signal::TERM)), 0 | 3));
    assert_eq!(code(&worker.end(Signal::TERM)), 0);

    let history = json(&output(["alarms", "--format", "json", capture.to_str().unwrap()]));
    let mut episodes = history["alarms"].as_array().unwrap().iter();
    let load =
        episodes.find(|episode| episode["robot"] == 1 && episode["alarm"] == "LevelHigh").unwrap();
    assert_eq!((&load["acknowledged"]["by"], &load["end"]), (&"ann".into(), &"cleared".into()));
    let verified = output(["replay", "--verify", "--format", "json", capture.to_str().unwrap()]);
    let report = json(&verified);
    assert_eq!(report["differences"], 0, "{report}");
    assert_eq!(report["verdict"], "verified", "{report}");
    let count = |name: &str| report[name].as_u64().unwrap();
    let verified = count("ticks_verified");
    assert!(verified > count("ticks_before_first_keyframe"), "{report}");
    assert_eq!(verified, count("ticks") - count("ticks_before_first_keyframe"), "{report}");
}
