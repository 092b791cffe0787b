//! Tests of the executable: real processes, exit codes, stdout and stderr.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod alarms;
mod ask;
mod battery;
mod captures;
mod data;
mod demo;
mod doors;
mod evaluate;
mod exits;
mod external;
mod fleet;
mod from_recordings;
mod killed;
mod live;
mod model;
mod new;
mod next_commands;
mod no_worker;
mod plausible;
mod printable;
mod proofs;
mod service;
mod signals;
mod special_files;
mod successors;
mod terminal;
mod train;

use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::process::Stdio;
use std::time::Duration;

use exits::{below, subcommands};
use fleet::{Exits as _, Fleet, code, done, joulebus, json, output, stderr, stdout};
use joulebus_config::Config;
use joulebus_testkit::{assert_contains, cases};

#[test]
fn every_verb_has_help_with_examples() {
    let help = output(["--help"]).exits(0);
    assert!(stdout(&help).contains("Exit codes"));
    for words in subcommands() {
        let help = output(words.iter().map(String::as_str).chain(["--help"]));
        assert_eq!(code(&help), 0, "{words:?}");
        assert!(stdout(&help).contains("Usage: joulebus"), "{words:?}");
        let is_leaf = below(&words).is_empty();
        assert!(!is_leaf || stdout(&help).contains("\nExample"), "{words:?}");
    }
}

#[test]
fn a_usage_error_exits_with_2_and_without_a_result() {
    let fleet = Fleet::new();
    let recording = fleet.recording("a.csv", 10).display().to_string();
    let config = fleet.config().display().to_string();
    // The last two: of two platforms, which is the robot's?
    for case in cases(
        "
        frobnicate | frobnicate
        --format xml doctor | xml
        publish | Usage
        publish trial | PATH
        publish sim --robots 0 | --robots
        publish sim --rate 0.01 | allowed are 0.1 to 1000 Hz
        publish sim --fault 3=melted | stuck
        publish sim --config CONFIG --robots 11 | ids for 10
        publish sim --config CONFIG --platform huksy | --first-robot
        publish sim --config CONFIG --robots 2 --fault 9=stuck | 0 to 1
        publish trial TRIAL --rate fast | is not a number
        publish trial TRIAL --rate NaN | allowed are
        publish trial TRIAL --loop=0 | from 1
        config explain tick.rate_hx | tick.rate_hz
        completions cmd | bash
        run --config /nowhere/fleet.toml | --config
        publish trial TRIAL --config CONFIG | @NAME
        eval TRIAL --config CONFIG | gternal, rover
        ",
    ) {
        let [arguments, expected] = case.as_slice() else {
            panic!("{case:?}");
        };
        let words = arguments.split(' ').map(|word| match word {
            "CONFIG" => &config,
            "TRIAL" => &recording,
            word => word,
        });
        let refused = output(words);
        let errors = stderr(&refused);
        assert_eq!(code(&refused), 2, "{arguments}: {errors}");
        assert_eq!(stdout(&refused), "", "{arguments}");
        assert!(errors.contains(expected), "{arguments}: {errors}");
    }
    assert_eq!(fleet.stale_files(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn a_typo_in_a_config_is_refused_with_its_line_and_the_nearest_key() {
    let fleet = Fleet::new();
    let path = fleet.path("typo.toml");
    let text = fs::read_to_string(fleet.config()).unwrap();
    fs::write(&path, text.replace("capacity", "capcity")).unwrap();
    let path = path.display().to_string();
    for arguments in [
        vec!["config", "check", &path],
        vec!["config", "show", &path],
        vec!["run", "--config", &path],
        vec!["publish", "sim", "--config", &path],
        vec!["doctor", "--config", &path],
    ] {
        let refused = output(&arguments);
        assert_eq!(code(&refused), 2, "{arguments:?}");
        let printed = stderr(&refused);
        assert!(printed.contains("typo.toml:3:"), "{arguments:?}: {printed}");
        assert_contains(&printed, ["capcity", "`fleet.capacity`"]);
    }
    let good = fleet.config().display().to_string();
    let checked = output(["config", "check", &good, &path, "--format", "json"]).exits(2);
    let files = &json(&checked)["files"];
    assert_eq!((&files[0]["accepted"], &files[1]["accepted"]), (&true.into(), &false.into()));
    assert_eq!(files[1]["problems"][0]["line"], 3);
}

#[test]
fn config_check_refuses_a_config_whose_model_the_worker_would_refuse() {
    let fleet = Fleet::new();
    let (path, model) = (fleet.path("model.toml"), fleet.path("broken.safetensors"));
    let text = fs::read_to_string(fleet.config()).unwrap();
    let named = format!("file = \"builtin:gternal\"\nmodel = \"{}\"", model.display());
    fs::write(&path, text.replace("file = \"builtin:gternal\"", &named)).unwrap();
    let path = path.display().to_string();
    for bytes in ["", "no model", "{}"] {
        fs::write(&model, bytes).unwrap();
        let ran = output(["run", "--config", &path]).exits(1);
        let checked = output(["config", "check", &path, "--format", "json"]).exits(2);
        // The same error text.
        let why = stderr(&ran);
        let why = why.trim().strip_prefix("error: ").unwrap();
        assert!(stderr(&checked).contains(why), "{why}: {}", stderr(&checked));
        let file = &json(&checked)["files"][0];
        assert_eq!(file["accepted"], false);
        assert!(file["error"].as_str().unwrap().contains("broken.safetensors"), "{file}");
    }
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn config_show_prints_an_equivalent_config() {
    let fleet = Fleet::new();
    let config = fleet.config().display().to_string();
    let shown = done(["config", "show", &config]);
    let again = Config::parse(&stdout(&shown), fleet.path("").as_path()).unwrap();
    let first = Config::load(fleet.config()).unwrap();
    assert_eq!(again.settings(), first.settings());
    assert_eq!(again.models(), first.models());
    assert_eq!((again.fleet(), again.root()), (first.fleet(), first.root()));
    let as_json = json(&output(["config", "show", &config, "--format", "json"]));
    assert_eq!(as_json["toml"], stdout(&shown).as_str());
    // Without a file: the built-in one, from any directory.
    let shipped = joulebus(["config", "show"]).current_dir("/").output().unwrap().exits(0);
    Config::parse(&stdout(&shipped), std::path::Path::new("/")).unwrap();
    // The variable names one for a whole shell, and an option another.
    let shown = |arguments: &[&str], variable: &str| {
        let mut command = joulebus(arguments.iter().copied());
        json(&command.env("JOULEBUS_CONFIG", variable).current_dir("/").output().unwrap().exits(0))
    };
    let (show, json) = (["config", "show", "--format", "json"], "fleet");
    assert_eq!(shown(&show, &config)[json], first.fleet());
    assert_eq!(shown(&show, "")[json], "lab");
    let named = ["config", "show", &config, "--format", "json"];
    assert_eq!(shown(&named, "/nowhere.toml")[json], first.fleet());
}

#[test]
fn keys_are_explained_as_text_and_as_json() {
    let text = stdout(&output(["config", "explain", "tick.rate_hz"]));
    assert!(text.contains("Hz") && text.contains("default 30"), "{text}");
    let keys = json(&output(["config", "explain", "tick", "--format", "json"]));
    let names: Vec<&str> =
        keys.as_array().unwrap().iter().flat_map(|key| key["key"].as_str()).collect();
    assert_eq!(names, ["tick.policy", "tick.rate_hz", "tick.deadline_ms"]);
}

#[test]
fn completions_contain_the_verbs() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = output(["completions", shell]);
        assert_eq!(code(&script), 0, "{shell}");
        assert_contains(&stdout(&script), ["publish", "doctor", "completions"]);
    }
}

#[test]
fn a_closed_stdout_is_no_error_and_no_panic() {
    for arguments in [vec!["config", "explain"], vec!["--help"], vec!["help", "record"]] {
        let (read, write) = std::io::pipe().unwrap();
        drop(read);
        let ended = joulebus(&arguments).stdout(write).stderr(Stdio::piped()).output().unwrap();
        assert_eq!(code(&ended), 0, "{arguments:?}: {}", stderr(&ended));
        assert_eq!(stderr(&ended), "", "{arguments:?}");
    }
}

#[test]
fn doctor_passes_on_a_fresh_fleet_and_leaves_no_files() {
    let fleet = Fleet::new();
    let healthy = fleet.output("doctor --format json").exits(0);
    let report = json(&healthy);
    let checks = report["checks"].as_array().unwrap();
    let about = |name: &str| {
        let check = checks.iter().find(|check| check["name"] == name);
        check.unwrap_or_else(|| panic!("no {name}"))["found"].as_str().unwrap().to_owned()
    };
    assert!(about("versions").contains("iceoryx2 0.10.0"));
    assert!(about("shared memory").contains("need "));
    assert!(about("models").contains("gternal"));
    assert!(about("worker").contains("none runs"));
    assert_eq!(about("stale files"), "none");
    assert!(fleet.stale_files().is_empty());
    assert_eq!(code(&fleet.output("doctor --fix")), 0);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn doctor_finds_and_removes_stale_files() {
    let fleet = Fleet::new();
    let unfinished = format!("/dev/shm/{}dead.connection", fleet.prefix());
    fs::write(&unfinished, "").unwrap();
    // A killed member leaves the directories that it made.
    let config = joulebus_config::Config::load(fleet.config()).unwrap();
    joulebus_bus::prepare_domain(&config.domain().unwrap()).unwrap();
    fs::set_permissions(fleet.root(), fs::Permissions::from_mode(0o755)).unwrap();
    // Younger ones may be under construction.
    std::thread::sleep(Duration::from_millis(400));

    let ill = fleet.output("doctor --format json").exits(1);
    let report = json(&ill);
    assert_eq!(report["status"], "fail");
    let failed: Vec<&str> = report["checks"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|check| check["status"] == "fail")
        .map(|check| check["name"].as_str().unwrap())
        .collect();
    assert_eq!(failed, ["root", "stale files"]);
    let mode = |path| fs::metadata(path).unwrap().mode() & 0o777;
    assert_eq!(mode(fleet.root()), 0o755, "doctor changed the mode");

    let mended = fleet.output("doctor --fix").exits(0);
    assert_contains(&stdout(&mended), ["0755 changed to 0700"]);
    assert!(!fs::exists(&unfinished).unwrap());
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn training_does_not_start_if_its_result_cannot_be_written() {
    let refused = output("train sim --seed 7 --out /nowhere/model.safetensors".split(' ')).exits(1);
    assert_contains(&stderr(&refused), ["/nowhere"]);
}
