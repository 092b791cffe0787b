//! Recordings in every form, and from recordings to a worker.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use super::doors::bag;
use super::fleet::{Exits as _, Fleet, Program, code, done, json, output, stderr, stdout};
use joulebus_testkit::trials::Files;
use joulebus_testkit::{assert_contains, eventually};
use rustix::process::Signal;
use serde_json::Value;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A recording of a robot of some 40 W at 20 Hz: `header` names time, power, v and ω, in SI units
/// divided by `units`.
fn recording(path: &Path, header: &str, units: [f64; 4], rows: u32, seed: u32) {
    let mut state = u64::from(seed) * 7_919 + 1;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 40) as f64 / f64::from(1 << 24) - 0.5
    };
    let mut table = format!("{header}\n");
    let (mut v, mut omega, mut power_w) = (0.0, 0.0, 40.0_f64);
    for row in 0..rows {
        v = (v + 0.1 * uniform()).clamp(-0.8, 0.8);
        omega = (omega + 0.3 * uniform()).clamp(-1.5, 1.5);
        power_w = 0.8 * power_w + 8.0 + 4.0 * f64::abs(v) + uniform();
        // A monitor of 10 mW.
        let reading_w = (power_w * 100.0).round() / 100.0;
        let values = [f64::from(row) / 20.0, reading_w, v, omega];
        let [t, p, v, omega] = std::array::from_fn(|at| values[at] / units[at]);
        writeln!(table, "{t},{p},{v},{omega}").unwrap();
    }
    fs::write(path, table).unwrap();
}

const GTERNAL: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors");
const LAYOUT: (&str, [f64; 4]) =
    ("timestamp_s,power_mW,v_cmd_mps,omega_cmd_radps", [1.0, 1e-3, 1.0, 1.0]);

/// The hash of the rows for training: one short epoch.
fn rows(folder: &Path, recordings: &[&str]) -> String {
    let recipe = folder.join("recipe.toml");
    let contents = "[training]\nmax_epochs = 1\n[split]\nby = \"time\"\n";
    fs::write(&recipe, contents).unwrap();
    let out = folder.join("m.safetensors");
    let begin = ["train", "trials", "--recipe", text(&recipe), "--out", text(&out)];
    done([&begin, recordings].concat());
    let info = json(&done(["model", "info", text(&out), "--format", "json"]));
    info["training_data_sha256"].as_str().unwrap().to_owned()
}

/// The values of a recording, as an array has them.
fn table(folder: &Path, recording: &str, columns: &[&str]) -> Vec<f64> {
    let array = tempfile::tempdir_in(folder).unwrap().keep().join("a.npy");
    done([&["data", "convert", recording, "--out", text(&array)], columns].concat());
    let bytes = fs::read(array).unwrap();
    let (words, _) = bytes[128..].as_chunks::<8>();
    words.iter().map(|word| f64::from_le_bytes(*word)).collect()
}

#[test]
fn usual_column_names_and_units_give_the_rows_of_the_published_layout() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let layout = at("layout.csv");
    recording(&layout, LAYOUT.0, LAYOUT.1, 600, 1);
    let expected = table(folder.path(), text(&layout), &[]);
    let ms = [1e-3, 1e-3, 1.0, 1.0];
    let map = "time=stamp,power_W=load,v=speed,omega=turn";
    for (name, header, units, map) in [
        ("si.csv", "time,power_W,v,omega", [1.0; 4], None),
        ("ms.csv", "Time (ms),P [mW],linear.x,yaw_rate", ms, None),
        ("own.csv", "stamp,load,speed,turn", [1.0; 4], Some(map)),
    ] {
        let path = at(name);
        recording(&path, header, units, 600, 1);
        let map: Vec<&str> = map.iter().flat_map(|map| ["--map", map]).collect();
        let found = table(folder.path(), text(&path), &map);
        // Times of 50 ms in another unit differ in the last place.
        let same = |(a, b): (&f64, &f64)| {
            (a.is_nan() && b.is_nan()) || (a - b).abs() <= 1e-9 * a.abs().max(1.0)
        };
        assert_eq!(found.len(), expected.len(), "{name}");
        assert!(expected.iter().zip(&found).all(same), "{name}");
    }
}

#[test]
fn all_missing_columns_are_named_at_once_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.csv");
    fs::write(&path, "stamp_of_log,load,power\n0,1,2\n1,2,3\n").unwrap();
    let refused = output(["data", "info", text(&path)]).exits(1);
    let parts = "timestamp_s | power_mW | stamp_of_log, load, power | --map";
    assert_contains(&stderr(&refused), parts.split(" | "));
    let mapped = |map: &str| output(["data", "info", text(&path), "--map", map]);
    let refused = mapped("time=stamp_of_log,power_W=lod");
    assert_contains(&stderr(&refused), ["power=lod"]);
    assert_eq!(code(&mapped("speed=load")), 2);
    mapped("time=stamp_of_log,power_W=load").exits(0);
    let help = stdout(&output(["data", "check", "--help"]));
    let parts = "power_mW | timestamp_s | omega_cmd_radps | yaw_rate | battery_voltage";
    assert_contains(&help, parts.split(" | "));
}

#[test]
fn a_capture_gives_the_rows_of_the_trials_that_it_was_made_of() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (a, b) = (at("a.csv"), at("b.csv"));
    recording(&a, LAYOUT.0, LAYOUT.1, 600, 1);
    recording(&b, LAYOUT.0, LAYOUT.1, 500, 2);
    let capture = at("both.mcap");
    let config = fleet.config().display().to_string();
    let files = [text(&a), text(&b)];
    let to = ["-o", text(&capture), "--config", &config];
    done([&["import"], &files[..], &to].concat());
    let expected = rows(folder.path(), &files);
    let found = rows(folder.path(), &[text(&capture)]);
    assert!(found == expected, "rows differ");

    // And as datasets again.
    let again = at("again");
    done(["import", text(&capture), "-o", text(&again)]);
    let entries = fs::read_dir(&again).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 2, "{files:?}");
    let paths: Vec<&str> = files.iter().map(|path| text(path)).collect();
    assert!(rows(folder.path(), &paths) == expected, "rows differ");

    // Every verb that reads recordings reads it, in a directory too.
    let captures = at("captures");
    fs::create_dir(&captures).unwrap();
    fs::copy(&capture, captures.join("both.mcap")).unwrap();
    let model = text(&at("m.safetensors")).to_owned();
    for command in [
        vec!["data", "info", text(&captures)],
        vec!["data", "check", text(&captures)],
        vec!["analyze", text(&captures), "--split", "time"],
        vec!["eval", text(&captures), "--model", &model],
    ] {
        let done = output(&command);
        assert!([0, 3].contains(&code(&done)), "{}", stderr(&done));
        assert!(!stdout(&done).is_empty(), "{command:?}");
    }
}

#[test]
fn config_init_writes_a_fleet_that_passes_config_check_and_prints_what_is_next() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("husky-like");
    fs::create_dir(&recordings).unwrap();
    for seed in 0..3 {
        let path = recordings.join(format!("run_{seed}.csv"));
        recording(&path, LAYOUT.0, LAYOUT.1, 400, seed);
    }
    let out = folder.path().join("lab");
    let (from, out_name) = (text(&recordings), text(&out));
    let init = ["config", "init", "--from", from, "--out", out_name];
    let battery = ["--battery-wh", "480", "--format", "json"];
    let report = json(&done(init.iter().chain(&battery)));
    let recorded = &report["recorded"];
    for (name, expected) in [("rate_hz", 20.0), ("resolution_w", 0.01)] {
        let off = (recorded[name].as_f64().unwrap() - expected).abs();
        assert!(off < 1e-6, "{recorded}");
    }
    let next = report["next"].to_string();
    assert_contains(&next, ["joulebus run --config", "train trials"]);

    let fleet = out.join("fleet.toml");
    let checked = done(["config", "check", text(&fleet)]);
    let errors = stderr(&checked);
    assert!(!errors.contains("warning"), "{errors}");
    let platform = fs::read_to_string(out.join("platforms/husky-like.toml")).unwrap();
    let parts = "rate_hz = 20.0 | power_resolution_w = 0.01 | capacity_wh = 480.0";
    assert_contains(&platform, parts.split(" | "));
    // The recordings are accepted by the platform made of them.
    done(["eval", from, "--config", text(&fleet), "--format", "json"]);

    // Nothing is overwritten.
    output(init).exits(2);
}

#[test]
fn config_init_makes_a_fleet_of_a_data_sheet_that_simulated_robots_fit() {
    let folder = tempfile::tempdir().unwrap();
    let init = |more: &str| {
        let out = folder.path().join("cart");
        let mut words: Vec<String> = format!("config init --out {} {more}", text(&out))
            .split(' ')
            .map(str::to_owned)
            .collect();
        words.retain(|word| !word.is_empty());
        words
    };
    let sheet = "--power 30-200 --speed 1.2 --battery-wh 480 --name cli --rate 30";
    for (wrong, why) in [
        ("", "--from"),
        ("--power 200-30", "30-200"),
        ("--power 30", "30-200"),
        ("--power 30-200 --speed 0", "above 0"),
        ("--power 30-200 --from .", "cannot be used with"),
        ("--power 30-200 --train", "cannot be used with"),
        ("--speed 1.2", "--power"),
    ] {
        let refused = output(init(wrong)).exits(2);
        assert_contains(&stderr(&refused), [why]);
    }
    let report = json(&done(init(&format!("{sheet} --format json"))));
    assert_eq!(report["recorded"]["trials"], 0);
    let path = folder.path().join("cart/platforms/cli.toml");
    let platform = fs::read_to_string(path).unwrap();
    let parts = "model = \"persistence\" | rate_hz = 30.0 | power_min_w = 0.0 | power_max_w = 250.0 | \
                 v_max_mps = 1.5 | omega_max_radps = 3.8 | capacity_wh = 480.0 | residual_std_w = 69.402 | \
                 Assumed: a reading says nothing";
    assert_contains(&platform, parts.split(" | "));
    let fleet = Fleet::new();
    let mut made = fs::read_to_string(folder.path().join("cart/fleet.toml")).unwrap();
    for (from, to) in [
        ("/dev/shm/joulebus-{uid}", fleet.root().to_str().unwrap()),
        ("prefix = \"jb_\"", "prefix = \"jbcli_\""),
        ("checkpoint = \"auto\"", "checkpoint = \"\""),
    ] {
        assert!(made.contains(from), "{made}");
        made = made.replace(from, to);
    }
    fs::rename(folder.path().join("cart/platforms"), fleet.path("platforms")).unwrap();
    fs::write(fleet.config(), made).unwrap();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 3 --format json"));
    let asked = || {
        let asked = fleet.output("ask --robot 1 --idle 600 --format json");
        let answer = serde_json::from_slice::<Value>(&asked.stdout).ok()?["answers"][0].take();
        answer["energy"]["mean_j"].is_number().then_some(answer)
    };
    let mut answer = None;
    eventually("robot 1 is asked about", || {
        answer = asked();
        answer.is_some()
    });
    let answer = answer.unwrap();
    // A robot of 30 to 200 W, and never an answer that is surer than that.
    let power_w = |name: &str| answer["energy"][name].as_f64().unwrap() / 600.0;
    assert!(power_w("mean_j") > 20.0 && power_w("hi_j") - power_w("lo_j") > 100.0, "{answer}");
    // Nothing of what the stand-ins draw and drive is outside of the limits.
    let sent = json(&source.end(Signal::TERM).exits(0));
    assert_eq!(sent["samples_refused"], serde_json::json!({}), "{sent}");
    let dropped = json(&worker.end(Signal::TERM).exits(0));
    assert_eq!(dropped["samples_dropped"], serde_json::json!({}));
}

#[test]
fn one_stuck_robot_sets_no_limit_for_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    fs::create_dir(&runs).unwrap();
    for seed in 0..3 {
        let path = runs.join(format!("run_{seed}.csv"));
        recording(&path, LAYOUT.0, LAYOUT.1, 400, seed);
    }
    let stuck = runs.join("stuck.csv");
    let rows = (0..400).map(|row| format!("{},40000,0.1,0.1\n", f64::from(row) / 20.0));
    fs::write(&stuck, format!("{}\n{}", LAYOUT.0, rows.collect::<String>())).unwrap();
    let out = folder.path().join("lab");
    let made = done(["config", "init", "--from", text(&runs), "--out", text(&out)]);
    assert_contains(&stderr(&made), ["stuck.csv", "far longer than those of the others"]);
    let platform = fs::read_to_string(out.join("platforms/runs.toml")).unwrap();
    assert_contains(&platform, ["\nhold_max_s = 0.5\n", "\nstuck_after_s = 10.0\n"]);
}

#[test]
fn config_init_with_wrong_options_writes_nothing_and_works_once_they_are_right() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.csv");
    recording(&path, LAYOUT.0, LAYOUT.1, 400, 1);
    let out = folder.path().join("lab");
    let init = |option: &str| {
        let init = ["config", "init", "--from", text(&path), "--out", text(&out)];
        output(init.iter().chain(&[option]))
    };
    let wrong = "--battery-wh=0 --battery-wh=nan --battery-wh=1e9 --robots=5-1 --robots=1,1";
    for option in wrong.split(' ') {
        let refused = init(option);
        assert_eq!(code(&refused), 2, "{option}: {}", stderr(&refused));
        assert!(!out.exists(), "{option}");
    }
    init("--battery-wh=5").exits(0);
}

#[test]
fn recordings_of_one_name_are_refused_before_any_is_imported() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["a", "b"].map(|name| folder.path().join(name).join("run.csv"));
    for (path, seed) in [(&one, 1), (&two, 2)] {
        fs::create_dir(path.parent().unwrap()).unwrap();
        recording(path, LAYOUT.0, LAYOUT.1, 100, seed);
    }
    let out = folder.path().join("trials");
    let both = output(["import", text(&one), text(&two), "-o", text(&out)]).exits(2);
    assert_contains(&stderr(&both), ["two recordings"]);
    assert!(!out.exists());
    let import = || output(["import", text(&one), "-o", text(&out)]);
    assert_eq!(code(&import()), 0);
    let again = import().exits(1);
    assert_contains(&stderr(&again), ["not overwritten"]);
}

#[test]
fn a_file_that_no_run_has_written_stays_where_a_result_would_be_put() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.csv");
    recording(&path, LAYOUT.0, LAYOUT.1, 200, 1);
    let out = folder.path().join("somebodys");
    fs::write(&out, "precious").unwrap();
    let model = GTERNAL;
    for command in [
        &["train", "trials", text(&path), "--split", "time", "--out"][..],
        &["model", "export", model, "--to", "npz", "--out"],
        &["model", "export", model, "--to", "python", "--out"],
    ] {
        let refused = output(command.iter().chain(&[text(&out)])).exits(1);
        assert_contains(&stderr(&refused), ["\"precious\""]);
        assert_eq!(fs::read_to_string(&out).unwrap(), "precious");
    }
    // Files of an earlier run are replaced.
    let exported = folder.path().join("model.npz");
    for _ in 0..2 {
        done(format!("model export {model} --to npz --out {}", text(&exported)).split(' '));
    }
}

#[test]
fn a_model_of_another_range_of_power_is_warned_about() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("runs");
    fs::create_dir(&recordings).unwrap();
    recording(&recordings.join("a.csv"), LAYOUT.0, LAYOUT.1, 400, 1);
    let out = folder.path().join("lab");
    let (from, to) = (text(&recordings), text(&out));
    done(format!("config init --from {from} --out {to} --model {GTERNAL}").split(' '));
    let checked = done(["config", "check", text(&out.join("fleet.toml"))]);
    let parts = ["warning", "was trained on readings of", "power_max_w"];
    assert_contains(&stderr(&checked), parts);
    // The model's own platform has no such warning.
    let own = output(["config", "check"]);
    assert!(!stderr(&own).contains("was trained on"), "{}", stderr(&own));
}

#[test]
fn a_model_of_another_rate_is_warned_about() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    fs::create_dir(&runs).unwrap();
    recording(&runs.join("a.csv"), LAYOUT.0, LAYOUT.1, 400, 1);
    let out = folder.path().join("lab");
    let init = format!("config init --from {} --out {} --name slow", text(&runs), text(&out));
    // 20 Hz. The model forecasts 33 ms ahead.
    let made = done((init + " --model builtin:gternal-sim").split(' '));
    let parts = ["warning", "gternal-sim was trained on a reading every 33.0 ms", "50.0 ms"];
    assert_contains(&stderr(&made), parts);
    let platform = out.join("platforms/slow.toml");
    let written = fs::read_to_string(&platform).unwrap();
    let checked_at = |rate_hz: f64| {
        let at = |line: &str| match line.starts_with("rate_hz = ") {
            true => format!("rate_hz = {rate_hz:?}\n"),
            false => format!("{line}\n"),
        };
        fs::write(&platform, written.lines().map(at).collect::<String>()).unwrap();
        let checked = done(["config", "check", text(&out.join("fleet.toml"))]);
        stderr(&checked).contains("was trained on a reading every")
    };
    // Periods of 40.0, 39.2, 27.0 and 26.0 ms.
    let found = [25.0, 25.5, 37.0, 38.5].map(checked_at);
    assert_eq!(found, [true, false, false, true]);
}

#[test]
fn config_init_takes_every_built_in_model() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    fs::create_dir(&runs).unwrap();
    recording(&runs.join("a.csv"), LAYOUT.0, LAYOUT.1, 300, 1);
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/models");
    let mut count = 0;
    for file in fs::read_dir(models).unwrap().map(|file| file.unwrap().path()) {
        let Some(name) = file.file_stem().filter(|_| file.extension().is_some()) else {
            continue;
        };
        let (name, out) = (name.to_str().unwrap(), folder.path().join(format!("lab{count}")));
        let init = ["config", "init", "--from", text(&runs), "--out", text(&out), "--name", "own"];
        let made = done([&init[..], &["--model", &format!("builtin:{name}")]].concat());
        assert_contains(&stdout(&made), ["against the last reading"]);
        let written = fs::read_to_string(out.join("platforms/own.toml")).unwrap();
        assert_contains(&written, [&*format!("model = \"builtin:{name}\"")]);
        done(["config", "check", text(&out.join("fleet.toml"))]);
        count += 1;
    }
    assert!(count >= 6, "{count}");
    let out = folder.path().join("none");
    let init = ["config", "init", "--from", text(&runs), "--out", text(&out)];
    let refused = output([&init[..], &["--model", "builtin:nothing"]].concat()).exits(2);
    assert_contains(&stderr(&refused), ["builtin:nothing", "builtin:husky"]);
    assert!(!out.exists());
}

/// A recording of power that wanders at random, so that nothing is better than the last reading.
fn random_walk(path: &Path, rows: u32, seed: u64) {
    let mut state = seed * 7_919 + 1;
    let mut table = "time,power_W\n".to_owned();
    let mut power_w = 40.0_f64;
    for row in 0..rows {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        power_w += if state >> 63 == 0 { 0.5 } else { -0.5 };
        power_w = power_w.clamp(10.0, 70.0);
        writeln!(table, "{},{power_w}", f64::from(row) / 20.0).unwrap();
    }
    fs::write(path, table).unwrap();
}

#[test]
fn config_init_writes_persistence_if_the_trained_model_is_no_better_and_says_it() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    fs::create_dir(&runs).unwrap();
    for seed in 0..4 {
        random_walk(&runs.join(format!("{seed}.csv")), 300, seed);
    }
    let from = text(&runs);
    let init = |out: &Path, more: &str| {
        let out = text(out);
        let asked =
            format!("config init --from {from} --out {out} --name own --format json {more}");
        json(&done(asked.split(' ')))
    };
    let platform = |out: &Path| fs::read_to_string(out.join("platforms/own.toml")).unwrap();
    let out = folder.path().join("trained");
    let report = init(&out, "--train");
    assert!(report["held_out"]["skill"]["value"].as_f64().unwrap() <= 0.0, "{report}");
    assert_eq!(report["persistence_is_better"], true);
    assert_eq!(report["uses_persistence"], true);
    assert_contains(&platform(&out), ["model = \"persistence\"", "../models/own.safetensors"]);
    done(["config", "check", text(&out.join("fleet.toml"))]);
    // Whoever names the model gets it, and is told as well.
    let model = out.join("models/own.safetensors");
    let told = folder.path().join("told");
    let report = init(&told, &format!("--model {}", text(&model)));
    assert_eq!(report["uses_persistence"], false);
    assert_contains(&platform(&told), ["own.safetensors"]);
    let again = folder.path().join("again");
    let asked = format!("config init --from {from} --out {} --train --name own", text(&again));
    let shown = done(asked.split(' '));
    assert_contains(&stdout(&shown), ["persistence is better here", "own.safetensors"]);
}

#[test]
fn train_reads_velocities_only_where_they_are_recorded_as_config_init_does() {
    let folder = tempfile::tempdir().unwrap();
    let features = |name: &str, more: &[&str]| {
        let runs = folder.path().join(name);
        let out = folder.path().join(format!("{name}-lab"));
        let model = folder.path().join(format!("{name}.safetensors"));
        let recipe = folder.path().join("recipe.toml");
        fs::write(&recipe, "[training]\nmax_epochs = 1\n").unwrap();
        let train = ["train", "trials", text(&runs), "--split", "time", "--out", text(&model)];
        done([&train[..], &["--recipe", text(&recipe)], more].concat());
        let init = ["config", "init", "--from", text(&runs), "--out", text(&out), "--name", "own"];
        done([&init[..], &["--train"]].concat());
        [model, out.join("models/own.safetensors")].map(|model| {
            let found = json(&done(["model", "info", text(&model), "--format", "json"]));
            found["feature_set"].as_str().unwrap().to_owned()
        })
    };
    for name in ["with", "without"] {
        fs::create_dir(folder.path().join(name)).unwrap();
    }
    recording(&folder.path().join("with/a.csv"), LAYOUT.0, LAYOUT.1, 300, 1);
    random_walk(&folder.path().join("without/a.csv"), 300, 1);
    assert_eq!(features("with", &[]), ["full", "full"]);
    assert_eq!(features("without", &[]), ["power_only", "power_only"]);
    // What is asked for is taken.
    fs::remove_dir_all(folder.path().join("with-lab")).unwrap();
    assert_eq!(features("with", &["--features", "power"])[0], "power_only");
}

#[test]
fn config_init_trains_when_asked_and_the_worker_starts_with_the_result() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("runs");
    fs::create_dir(&recordings).unwrap();
    for seed in 0..2 {
        let path = recordings.join(format!("{seed}.csv"));
        recording(&path, LAYOUT.0, LAYOUT.1, 300, seed);
    }
    let out = folder.path().join("lab");
    let (from, to) = (text(&recordings), text(&out));
    let init = format!("config init --from {from} --out {to} --train --name mine");
    done(init.split(' '));
    assert!(out.join("models/mine.safetensors").is_file());
    let fleet = out.join("fleet.toml");
    let checked = done(["config", "check", text(&fleet)]);
    let errors = stderr(&checked);
    assert!(!errors.contains("warning"), "{errors}");

    // Nor is a model overwritten.
    fs::remove_file(&fleet).unwrap();
    fs::remove_file(out.join("platforms/mine.toml")).unwrap();
    fs::write(out.join("models/mine.safetensors"), b"of somebody").unwrap();
    let again = output(init.split(' ')).exits(2);
    assert!(stderr(&again).contains("mine.safetensors exists"));
    let kept = fs::read(out.join("models/mine.safetensors")).unwrap();
    assert_eq!(kept, b"of somebody");
}

#[test]
fn a_recording_without_any_power_that_is_consumed_is_refused() {
    let files = Files::new();
    let table = |header: &str, row: &dyn Fn(u32) -> String| {
        let rows = (0..200).map(|number| format!("{},{}\n", 0.1 * f64::from(number), row(number)));
        header.to_owned() + "\n" + &rows.collect::<String>()
    };
    let volt = |number: u32| 24.6 + 0.01 * f64::from(number % 7);
    let docked = table("timestamp_s,voltage_V,current_A,is_charging", &|number| {
        format!("{},{},true", volt(number), -2.9 + 0.01 * f64::from(number % 5))
    });
    let unmeasured =
        table("timestamp_s,voltage_V,current_A", &|number| format!("{},-1", volt(number)));
    let mut cases = vec![
        (files.write("docked.csv", docked.as_bytes()), ""),
        (files.write("unmeasured.csv", unmeasured.as_bytes()), "--map missing:=-1"),
    ];
    for (name, planted) in [
        ("docked.mcap", "nothing but a charger"),
        ("unmeasured.mcap", "a current that nobody measures"),
    ] {
        cases.push((files.write(name, &bag(planted).unwrap()), ""));
    }
    for (path, options) in cases {
        let out = path.with_extension("out.csv");
        let words = ["import", text(&path), "-o", text(&out)];
        let options = options.split_whitespace();
        let refused = output(words.into_iter().chain(options)).exits(1);
        let errors = stderr(&refused);
        assert!(errors.contains("no reading has a power that it consumes"), "{path:?}: {errors}");
        assert!(!out.exists(), "{path:?}");
    }
}
