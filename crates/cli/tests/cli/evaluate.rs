//! `joulebus eval` and `joulebus model compare`: scored rows, output and exit codes.

use std::fs;
use std::path::{Path, PathBuf};

use joulebus_testkit::assert_contains;
use joulebus_testkit::recordings::shared;
use serde_json::Value;

use super::fleet::{Exits as _, Fleet, code, done, json, output, stderr, stdout};

const MODELS: [&str; 2] = [
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors"),
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim-power.safetensors"),
];

/// Recordings of two groups in one directory with power that reverts to its mean.
fn recordings(folder: &Path, trials: u32, rows: u32) -> PathBuf {
    let folder = folder.join("recordings");
    fs::create_dir(&folder).unwrap();
    for trial in 0..trials {
        let mut text = "robot_id,timestamp_s,power_mW,v_cmd_mps,omega_cmd_radps\n".to_owned();
        let mut state = u64::from(trial) + 1;
        let mut wander = 0.0;
        for row in 0..rows {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            wander = 0.9 * wander + ((state >> 40) as f64 / f64::from(1 << 24) - 0.5) * 300.0;
            let (time_s, v) = (f64::from(row) / 30.0, f64::from(row / 30 % 4) * 0.05);
            let power_mw = 3_600.0 + wander + 2_000.0 * v;
            text += &format!("r{},{time_s:.4},{power_mw:.1},{v},0.3\n", trial % 2);
        }
        let group = ["sand", "ice"][trial as usize % 2];
        fs::write(folder.join(format!("{group}_{trial:02}.csv")), text).unwrap();
    }
    folder
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn forecaster<'a>(cell: &'a Value, name: &str) -> &'a Value {
    let all = cell["forecasters"].as_array().unwrap();
    let found = all.iter().find(|one| one["name"] == name);
    found.unwrap_or_else(|| panic!("{name}: {cell}"))
}

#[test]
fn a_directory_is_evaluated_by_group_robot_and_trial() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 120, 60);
    let asked = ["eval", "--model", MODELS[0], text(&data), "--resamples", "100"];
    let report = json(&done([&asked[..], &["--format", "json"]].concat()));
    // More trials than the config has ids: all are evaluated.
    let evaluation = &report["evaluations"][0];
    assert_eq!(evaluation["platform"], "recorded");
    for (part, length) in [("groups", 2), ("robots", 2), ("trials", 120)] {
        assert_eq!(evaluation[part].as_array().unwrap().len(), length);
    }
    let all = &evaluation["all"];
    assert_eq!(all["rows"], 120 * 55);
    assert_eq!(all["blocks"]["whole_trials"], true);
    let line = forecaster(all, "AR(5) + velocities");
    let r2 = &line["r2"];
    assert!(r2["lo"].as_f64() < r2["value"].as_f64(), "{line}");
    // Power reverts to its mean.
    assert!(line["skill"][0]["value"].as_f64().unwrap() > 0.0);
    let model = &all["forecasters"][0];
    let coverage = model["interval"]["coverage"].as_f64();
    assert!(coverage.unwrap() > 0.5, "{model}");
    let shown = output(asked);
    let parts = "AR(5) + velocities | By group | sand | By robot | skill | MAPE | no split";
    assert_contains(&stdout(&shown), parts.split(" | "));
    // 120 trials are not listed one by one.
    assert!(stdout(&shown).lines().count() < 80);
}

#[test]
fn a_built_in_model_is_named_as_in_a_config() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 2, 60);
    let with = |model: &str| output(["eval", "--format", "json", "--model", model, text(&data)]);
    let (by_name, by_file) = (with("builtin:gternal-sim"), with(MODELS[0]));
    assert_eq!(code(&by_name), 0, "{}", stderr(&by_name));
    assert_eq!(json(&by_name), json(&by_file));
    let refused = with("builtin:nothing").exits(2);
    assert_contains(&stderr(&refused), ["builtin:nothing", "builtin:gternal-sim-power"]);
}

#[test]
fn rows_trained_on_are_recognised_under_other_names_and_in_captures_and_scored_apart() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 10, 80);
    let model = folder.path().join("own.safetensors");
    let recipe = folder.path().join("recipe.toml");
    fs::write(&recipe, "[training]\nmax_epochs = 1\n").unwrap();
    let (recipe, model) = (text(&recipe), text(&model));
    let train = format!("train trials {} --recipe {recipe}", text(&data));
    let trained = done(format!("{train} --out {model} --format json").split(' '));
    let split = json(&trained)["split"].clone();
    let of = |part: &str| PathBuf::from(split[part][0].as_str().unwrap());
    let eval = |path: &Path| {
        let arguments = ["eval", "--model", model, text(path), "--resamples", "0"];
        let done = done([&arguments[..], &["--format", "json"]].concat());
        (json(&done)["evaluations"][0].clone(), stderr(&done))
    };

    // 8 of 10 trials of 75 rows were trained on or chose the epoch: the other two are the headline.
    let (whole, shown) = eval(&data);
    assert_eq!(whole["models"][0]["trained_on"]["rows"], 8 * 75, "{whole}");
    assert_eq!(whole["all"]["rows"], 2 * 75);
    assert_eq!(whole["trained_on"]["rows"], 8 * 75);
    assert_eq!(whole["scored_rows"], "none_recognised");
    assert_contains(&shown, ["warning", "80.0 %"]);

    let renamed = folder.path().join("new name.csv");
    fs::copy(of("training"), &renamed).unwrap();
    let capture = fleet.path("played.mcap");
    let mut import = fleet.joulebus("import");
    import.arg(of("training")).arg("-o").arg(&capture);
    import.output().unwrap().exits(0);
    for path in [renamed, capture, of("validation")] {
        let (found, shown) = eval(&path);
        assert_eq!(found["models"][0]["trained_on"]["share"], 1.0, "{path:?}");
        assert_eq!(found["scored_rows"], "trained_on");
        assert!(shown.contains("100.0 %"), "{shown}");
    }
    let (found, shown) = eval(&of("held_out"));
    assert_eq!(found["models"][0]["trained_on"]["rows"], 0);
    assert!(!shown.contains("warning"), "{shown}");
}

#[test]
fn a_usage_error_lists_the_allowed_values() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 2, 40);
    for (arguments, part) in [
        ("--horizons 1,30", "--energy"),
        ("--split trial", "at least 3"),
        ("--split row", "trial"),
        ("--split time --held-out 0.9", "less than 1"),
        ("--held-out 0.2", "--split"),
        ("--confidence 1", "joulebus.lab"),
    ] {
        let asked = ["eval", "--model", MODELS[0], text(&data)];
        let refused = output(asked.into_iter().chain(arguments.split(' ')));
        let errors = stderr(&refused);
        assert_eq!(code(&refused), 2, "{arguments}: {errors}");
        assert!(errors.contains(part), "{arguments}: {errors}");
        assert_eq!(stdout(&refused), "");
    }
}

#[test]
fn platforms_of_a_config_are_evaluated_separately() {
    let fleet = Fleet::new();
    let one = fleet.recording("a.csv", 200);
    // A rover publishes no velocities.
    let other = fleet.path("b.csv");
    let row = |row| format!("{:.4},{}\n", f64::from(row) / 30.0, 10_000 + row % 7 * 100);
    let rows: String = (0..90).map(row).collect();
    fs::write(&other, format!("timestamp_s,power_mW\n{rows}")).unwrap();
    let mut eval = fleet.joulebus("eval --format json");
    eval.arg(format!("{}@gternal", one.display()));
    eval.arg(format!("{}@rover", other.display()));
    let report = json(&eval.output().unwrap());
    for (place, platform) in ["gternal", "rover"].into_iter().enumerate() {
        assert_eq!(report["evaluations"][place]["platform"], platform);
    }
    assert_eq!(report["evaluations"].as_array().unwrap().len(), 2);
}

#[test]
fn a_comparison_shows_differences_and_exits_with_3_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 24, 150);
    let compare = |old: &str, new: &str, more: &[&str]| {
        let data = text(&data);
        let asked = ["model", "compare", old, new, data, "--resamples", "200"];
        output([&asked[..], more].concat())
    };
    let forwards = compare(MODELS[0], MODELS[1], &["--format", "json"]);
    let backwards = compare(MODELS[1], MODELS[0], &["--format", "json"]);
    let (forwards, backwards) = (json(&forwards), json(&backwards));
    let all = |report: &Value| report["comparisons"][0]["all"].clone();
    let difference = |report: &Value| all(report)["mae_w"]["value"].as_f64().unwrap();
    assert!((difference(&forwards) + difference(&backwards)).abs() < 1e-12);
    assert!(difference(&forwards) != 0.0);
    let trials = forwards["comparisons"][0]["trials"].as_array();
    assert_eq!(trials.unwrap().len(), 24);
    let verdicts =
        [&forwards, &backwards].map(|report| all(report)["verdict"].as_str().unwrap().to_owned());
    let orders = [(MODELS[0], MODELS[1]), (MODELS[1], MODELS[0])];
    for (report, (old, new)) in verdicts.iter().zip(orders) {
        let worse = if report == "worse" { 3 } else { 0 };
        assert_eq!(code(&compare(old, new, &[])), 0, "{report}");
        assert_eq!(code(&compare(old, new, &["--fail-worse"])), worse);
    }
    // Two models that differ much.
    assert!(verdicts.contains(&"worse".to_owned()), "{verdicts:?}");
    let same = compare(MODELS[0], MODELS[0], &["--fail-worse"]).exits(0);
    assert!(stdout(&same).contains("undecided"), "{}", stdout(&same));
    let parts = "old: model | By group | By robot | By trial | new − old | paired";
    assert_contains(&stdout(&same), parts.split(" | "));
}

/// A number as documents write it.
fn shown(value: &Value, scale: f64, digits: usize) -> String {
    let value = value.as_f64().unwrap_or(f64::NAN);
    format!("{:.digits$}", scale * value).replace('-', "−")
}

/// A score with its interval.
fn with_interval(score: &Value) -> String {
    let [value, lo, hi] = ["value", "lo", "hi"].map(|key| shown(&score[key], 1.0, 4));
    format!("{value} [{lo}, {hi}]")
}

#[test]
fn the_scores_of_shipped_models_in_documents_are_those_that_eval_prints() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let read = |path: &str| fs::read_to_string(root.join(path)).unwrap();
    let Some(data) = shared("data") else {
        return;
    };
    let table = read("docs/reference/models.md");
    // Online, network, AR(5), last reading.
    let mut known_floors: Vec<[String; 4]> = Vec::new();
    for (model, folder) in
        [("robotino", "robotino"), ("husky", "borealtc_husky"), ("rover", "ase_rover")]
    {
        let data = data.join(folder);
        let model_option = format!("builtin:{model}");
        let begin = ["eval", text(&data), "--model", &model_option, "--split", "trial"];
        let done = done([&begin[..], &["--format", "json"]].concat());
        let all = &json(&done)["evaluations"][0]["all"];
        let of = |name: &str| forecaster(all, name);
        let [online, network] =
            ["online", "network"].map(|forecast| of(&format!("{model} ({forecast})")));
        let [persistence, line, ridge, mean] =
            ["persistence", "AR(5)", "ridge, AR(5) + velocities", "mean so far"].map(of);
        let rows = all["rows"].as_u64().unwrap();
        let skill = |against: &str| {
            let mut skills = online["skill"].as_array().unwrap().iter();
            skills.find(|skill| skill["against"] == against).unwrap()
        };
        let cells = [
            model.to_owned(),
            format!("{},{:03}", rows / 1_000, rows % 1_000),
            with_interval(&online["r2"]),
            with_interval(&network["r2"]),
            with_interval(&persistence["r2"]),
            shown(&line["r2"]["value"], 1.0, 4),
            shown(&ridge["r2"]["value"], 1.0, 4),
            shown(&mean["r2"]["value"], 1.0, 4),
            with_interval(skill("persistence")),
            shown(&skill("AR(5)")["value"], 1.0, 2),
            format!("{} %", shown(&online["interval"]["coverage"], 100.0, 2)),
            format!("{} %", shown(&online["energy_error"]["value"], 100.0, 2)),
        ];
        let expected = format!("| {} |", cells.join(" | "));
        assert!(table.contains(&expected), "docs/reference/models.md lacks this line:\n{expected}");
        let found = [online, network, line, persistence];
        known_floors.push(found.map(|found| shown(&found["r2"]["value"], 1.0, 3)));
    }
    let page = read("docs/explanation/where-to-use-it.md");
    let names = ["Robotino, known floors", "Husky, known floors", "rover, known software"];
    for (name, found) in names.iter().zip(known_floors) {
        // The table of trips has rows of the same names, with other columns.
        let mut rows = page.lines().map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
        let cells = rows.find(|cells| cells.len() == 8 && cells[1] == *name).unwrap();
        // Beside them stands LightGBM, which another program trains.
        assert_eq!([2, 4, 5, 6].map(|place| cells[place]), found, "{name}: {cells:?}");
    }
}

#[test]
fn the_trips_of_recorded_drives_in_the_page_are_those_that_eval_prints() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let Some(data) = shared("data") else {
        return;
    };
    let page = fs::read_to_string(root.join("docs/explanation/where-to-use-it.md")).unwrap();
    for (name, recordings) in [
        ("Husky, wet grass", "husky_commanded/wetgrass*"),
        ("Husky, wheels up", "husky_commanded/wheels_up*"),
        ("Warthog, grass", "warthog_commanded/*.csv.gz"),
    ] {
        let pattern = data.join(recordings);
        let report = json(&done(["eval", "--trips", text(&pattern), "--format", "json"]));
        assert_eq!(
            report["trips"].as_array().unwrap().len(),
            report["drives"][0].as_u64().unwrap() as usize
        );
        let rows = report["rows"].as_array().unwrap();
        let is_whole = |row: &&Value| row["length_s"].is_null() && row["left_out"] == "drive";
        let row = rows.iter().find(is_whole).unwrap();
        let percent = |value: &Value| {
            if value.is_null() { "–".to_owned() } else { format!("{} %", shown(value, 100.0, 1)) }
        };
        let others = row["others"].as_array().unwrap();
        let mut cells = vec![name.to_owned(), row["trips"].to_string(), percent(&row["mape"])];
        cells.extend(others.iter().map(percent));
        cells.push(percent(&row["coverage"]));
        cells.push(shown(&row["score"], 1.0, 2));
        cells.extend(["right_yes", "wrong_yes_bound"].map(|key| percent(&row[key])));
        let expected = format!("| {} |", cells.join(" | "));
        assert!(page.contains(&expected), "docs/explanation/where-to-use-it.md lacks\n{expected}");
    }
    let twice = output(["eval", "--trips", text(&data), "--model", MODELS[0]]).exits(2);
    assert_contains(&stderr(&twice), ["--trips"]);
}

#[test]
fn the_scores_of_the_simulated_model_in_the_readme_are_those_of_its_file() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let scores = json(&done(["model", "info", "builtin:gternal-sim", "--format", "json"]));
    let scores = &scores["scores"];
    let [r2, last_r2] = ["r2", "persistence_r2"].map(|key| shown(&scores[key], 1.0, 3));
    let readme = fs::read_to_string(root.join("README.md")).unwrap();
    let readme = readme.split_whitespace().collect::<Vec<&str>>().join(" ");
    assert_contains(&readme, [&*format!("alone has {r2}, the last reading {last_r2}")]);
}
