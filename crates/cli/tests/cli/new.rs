//! Projects of `joulebus new`: written, refused, and in Rust built and run as printed. Those in
//! Python are run by the tests of the Python package, those in C++ by `tools/c_api.sh`.

use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::Command;

use joulebus_testkit::eventually;
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::Value;

use crate::fleet::{Fleet, Program, code, joulebus, json, stderr, stdout};

/// Alarms that a late process raises: a test does not depend on being scheduled.
const OF_TIMING: [&str; 6] =
    ["NoData", "HeldTooLong", "DeadlineMissed", "WatchdogStop", "WorkerStale", "WorkerGone"];

/// `joulebus new` in the fleet's folder, with its report.
fn new(fleet: &Fleet, arguments: &[&str]) -> Value {
    let mut command = joulebus(["new", "--format", "json"]);
    command.args(arguments).current_dir(fleet.path(""));
    let written = command.output().unwrap();
    assert_eq!(code(&written), 0, "{}", stderr(&written));
    json(&written)
}

#[test]
fn projects_in_all_languages_name_the_sources_and_commands_that_run_them() {
    let fleet = Fleet::new();
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let sources = fs::canonicalize(sources).unwrap();
    for (kind, lang, own, names, runs) in [
        ("controller", "rust", "src/main.rs", "Cargo.toml", "cargo run"),
        ("planner", "rust", "src/main.rs", "Cargo.toml", "cargo run"),
        ("controller", "python", "controller.py", "requirements.txt", "venv/bin/python"),
        ("planner", "python", "planner.py", "requirements.txt", "venv/bin/python"),
        ("controller", "cpp", "controller.cpp", "", "build/controller"),
        ("planner", "cpp", "planner.cpp", "", "build/planner"),
    ] {
        let folder = format!("a {kind}'s/{lang}");
        let written = new(&fleet, &[kind, "--lang", lang, &folder]);
        assert_eq!(written["missing"], Value::Null);
        let text = |name: &str| fs::read_to_string(fleet.path(&folder).join(name)).unwrap();
        assert!(text(own).contains(kind), "{lang}");
        assert!(text("configs/fleet.toml").contains("[platform.battery]"));
        for file in written["files"].as_array().unwrap() {
            assert!(!text(file.as_str().unwrap()).contains('@'), "{file}");
        }
        let sources = sources.to_str().unwrap();
        match names {
            "" => assert!(written["prepare"][0].to_string().contains(sources)),
            names => assert!(text(names).contains(sources)),
        }
        let command = written["run"][1]["command"].as_str().unwrap();
        let quoted = format!("cd 'a {kind}'\\''s/{lang}' && {runs}");
        assert!(command.starts_with(&quoted), "{command}");
    }
}

#[test]
fn a_folder_that_has_files_and_a_clone_that_is_none_are_refused() {
    let fleet = Fleet::new();
    let there = fleet.path("fleet.toml").display().to_string();
    let full = fleet.path("").display().to_string();
    let new = fleet.path("new").display().to_string();
    for (arguments, expected) in [
        (vec![full.as_str()], "is not empty: name a new or an empty folder"),
        (vec![&there], "is not a folder: name a new or an empty folder"),
        (vec![&new, "--sources", &full], "--sources names a clone of joulebus"),
    ] {
        let refused = joulebus(["new", "planner"]).args(&arguments).output().unwrap();
        assert_eq!(code(&refused), 2, "{refused:?}");
        assert!(stderr(&refused).contains(expected), "{refused:?}");
        assert_eq!(stdout(&refused), "");
    }
    assert!(!fs::exists(new).unwrap());
}

/// A command as printed, with all processes that it starts: killed when dropped.
struct Printed(Program);

impl Printed {
    fn start(fleet: &Fleet, command: &Value) -> Self {
        let mut shell = Command::new("sh");
        shell.args(["-c", command["command"].as_str().unwrap()]);
        shell.current_dir(fleet.path("")).process_group(0);
        Self(Program::start(shell))
    }
}

impl Drop for Printed {
    fn drop(&mut self) {
        let group = Pid::from_raw(self.0.pid().cast_signed()).unwrap();
        let _ = kill_process_group(group, Signal::KILL);
    }
}

/// A project in Rust that uses what the workspace has compiled, and a fleet of its own; with its
/// report.
fn project_in_rust(fleet: &Fleet, kind: &str) -> Value {
    let written = new(fleet, &[kind, &format!("my-{kind}")]);
    let project = fleet.path(&format!("my-{kind}"));
    let config = project.join("configs/fleet.toml");
    let text = fs::read_to_string(&config).unwrap();
    let root = fleet.root().display();
    let own =
        format!("[domain]\nroot = \"{root}\"\nprefix = \"jbcli_\"\n[ledger]\ncheckpoint = \"\"\n");
    let text = text.replace("name = \"lab\"", "name = \"cli\"");
    fs::write(&config, text.replace("[[platform]]", &format!("{own}[[platform]]"))).unwrap();

    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    fs::copy(workspace.join("Cargo.lock"), project.join("Cargo.lock")).unwrap();
    let manifest = fs::read_to_string(workspace.join("Cargo.toml")).unwrap();
    let from = manifest.find("[profile.dev]").unwrap();
    let to = manifest.find("[profile.release]").unwrap();
    let target = Path::new(env!("CARGO_BIN_EXE_joulebus")).ancestors().nth(2).unwrap();
    let target = format!("[build]\ntarget-dir = {target:?}\n[net]\noffline = true\n");
    fs::create_dir(project.join(".cargo")).unwrap();
    fs::write(project.join(".cargo/config.toml"), target + &manifest[from..to]).unwrap();
    let mut cargo = Command::new("cargo");
    cargo.args(["build", "--quiet"]).current_dir(&project);
    let built = cargo.output().unwrap();
    assert_eq!(code(&built), 0, "{}", stderr(&built));
    written
}

/// The robots of a fleet, as `joulebus watch` shows them; none while no worker runs.
fn robots(config: &Path) -> Vec<Value> {
    let watch = joulebus(["watch", "--once", "--format", "json", "--config"]).arg(config).output();
    match watch.unwrap() {
        seen if code(&seen) == 0 => json(&seen)["robots"].as_array().unwrap().clone(),
        _ => Vec::new(),
    }
}

/// As printed: the worker, the projects' programs, and the view.
#[test]
fn projects_in_rust_run_as_printed_beside_a_worker_without_an_alarm() {
    let fleet = Fleet::new();
    let [planner, controller] = ["planner", "controller"].map(|kind| project_in_rust(&fleet, kind));
    let config = fleet.path("my-planner/configs/fleet.toml");
    let mut reader = Printed::start(&fleet, &planner["run"][1]);
    reader.0.wait_for_stdout("no forecasts: does a worker run");
    let mut worker = Printed::start(&fleet, &planner["run"][0]);
    worker.0.wait_for_stderr("ready:");
    let mut alarms = joulebus(["alarms", "--format", "json", "--config"]);
    alarms.arg(&config);
    let mut alarms = Program::start(alarms);
    alarms.wait_for_stderr("alarms of fleet");
    let _controller = Printed::start(&fleet, &controller["run"][1]);
    // An interval: of a robot that is unknown it prints none.
    reader.0.wait_for_stdout(" to ");

    let mut first = Vec::new();
    eventually("all robots have forecasts, and batteries for twelve seconds", || {
        let seen = robots(&config);
        let is_number = |robot: &Value, name: &str| robot[name].is_number();
        let are_known = seen.len() == 20 && seen.iter().all(|robot| is_number(robot, "power_w"));
        if first.is_empty() && are_known {
            first = seen.clone();
        }
        let has_drawn = |robot: &Value| {
            robot["metered_s"].as_f64() > Some(12.0) && is_number(robot, "time_to_empty_s")
        };
        let mut pairs = seen.iter().zip(&first);
        are_known
            && seen.iter().all(has_drawn)
            && pairs.all(|(now, before)| now["power_w"] != before["power_w"])
    });
    let ended = stdout(&alarms.end(Signal::INT));
    let raised = ended.lines().filter(|line| {
        let change: Value = serde_json::from_str(line).unwrap();
        !OF_TIMING.contains(&change["alarm"].as_str().unwrap())
    });
    assert_eq!(raised.collect::<Vec<_>>(), Vec::<&str>::new());
}
