//! `joulebus eval` and `joulebus model compare`: scored rows, output and exit codes.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::fleet::{Fleet, code, joulebus, json, output, stderr, stdout};

const MODELS: [&str; 2] = [
    concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../configs/models/gternal-sim.safetensors"
    ),
    concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../configs/models/gternal-sim-power.safetensors"
    ),
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
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
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
    let asked = [
        "eval",
        "--model",
        MODELS[0],
        text(&data),
        "--resamples",
        "100",
        "--format",
        "json",
    ];
    let evaluated = output(asked);
    assert_eq!(code(&evaluated), 0, "{}", stderr(&evaluated));
    let report = json(&evaluated);
    // More trials than the config has ids: all are evaluated.
    assert_eq!(report["robots"].as_array().unwrap().len(), 120);
    assert_eq!(report["platforms"][0]["platform"], "recorded");
    let evaluation = &report["evaluations"][0];
    let lengths =
        ["groups", "robots", "trials"].map(|part| evaluation[part].as_array().unwrap().len());
    assert_eq!(lengths, [2, 2, 120]);
    let all = &evaluation["all"];
    assert_eq!(all["rows"], 120 * 55);
    assert_eq!(all["blocks"]["whole_trials"], true);
    let line = forecaster(all, "AR(5) + velocities");
    assert!(
        line["r2"]["lo"].as_f64() < line["r2"]["value"].as_f64(),
        "{line}"
    );
    assert!(
        line["skill"][0]["value"].as_f64().unwrap() > 0.0,
        "power reverts to its mean"
    );
    let model = &all["forecasters"][0];
    assert!(
        model["interval"]["coverage"].as_f64().unwrap() > 0.5,
        "{model}"
    );
    let horizons = evaluation["open_loop"]["horizons"].as_array().unwrap();
    let reached: Vec<_> = horizons
        .iter()
        .map(|one| (one["ticks"].as_u64(), one["origins"].as_u64()))
        .collect();
    assert_eq!(reached[0], (Some(1), Some(120 * 55)), "every row");
    assert_eq!(
        reached[5],
        (Some(300), Some(0)),
        "a trial of 60 rows says nothing about 300 ticks"
    );
    assert!(horizons[5]["forecasters"][0]["r2"]["value"].is_null());

    let told = output([&asked[..6], &["--horizons", "1,20"]].concat());
    for said in [
        "AR(5) + velocities",
        "By group",
        "sand",
        "By robot",
        "skill",
        "Open loop",
        "MAPE",
        "no split",
    ] {
        assert!(stdout(&told).contains(said), "{said}: {}", stdout(&told));
    }
    assert!(
        stdout(&told).lines().count() < 80,
        "120 trials are not listed one by one"
    );
}

#[test]
fn a_built_in_model_is_named_as_in_a_config() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 2, 60);
    let with = |model: &str| output(["eval", "--format", "json", "--model", model, text(&data)]);
    let (by_name, by_file) = (with("builtin:gternal-sim"), with(MODELS[0]));
    assert_eq!(code(&by_name), 0, "{}", stderr(&by_name));
    assert_eq!(json(&by_name), json(&by_file));
    let refused = with("builtin:nothing");
    assert_eq!(code(&refused), 2);
    for name in ["builtin:nothing", "builtin:gternal-sim-power"] {
        assert!(stderr(&refused).contains(name), "{}", stderr(&refused));
    }
}

#[test]
fn split_holds_out_the_trials_that_training_held_out() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 10, 80);
    let model = folder.path().join("own.safetensors");
    let recipe = folder.path().join("recipe.toml");
    fs::write(&recipe, "[training]\nmax_epochs = 2\n").unwrap();
    let trained = output([
        "train",
        "trials",
        text(&data),
        "--recipe",
        text(&recipe),
        "--seed",
        "3",
        "--out",
        text(&model),
    ]);
    assert_eq!(code(&trained), 0, "{}", stderr(&trained));
    let eval = |seed: &str, by: &str| {
        let asked = [
            "eval",
            "--model",
            text(&model),
            text(&data),
            "--split",
            by,
            "--seed",
            seed,
        ];
        let done = output(
            [
                &asked[..],
                &["--resamples", "0", "--horizons", "none", "--format", "json"],
            ]
            .concat(),
        );
        assert_eq!(code(&done), 0, "{}", stderr(&done));
        json(&done)["evaluations"][0].clone()
    };
    let own = eval("3", "trial");
    assert_eq!(own["models"][0]["trained_on"]["rows"], 0, "{own}");
    assert_eq!(own["scored_rows"], "not_trained_on", "{own}");
    assert_eq!(
        (
            own["design"]["trials"].as_u64(),
            own["trials"].as_array().unwrap().len()
        ),
        (Some(2), 2)
    );
    assert_eq!(own["design"]["split"]["by"], "trial");
    let description = own["design"]["description"].as_str().unwrap();
    for said in ["split by trial", "seed 3"] {
        assert!(description.contains(said), "{description}");
    }
    assert!(own["open_loop"]["horizons"].as_array().unwrap().is_empty());
    let other = eval("4", "trial");
    assert_ne!(other["models"][0]["trained_on"]["rows"], 0, "{other}");
    let in_time = eval("3", "time");
    assert_eq!(in_time["design"]["trials"], 10);
    let told = output([
        "eval",
        "--model",
        text(&model),
        text(&data),
        "--split",
        "trial",
        "--seed",
        "3",
    ]);
    assert!(
        stdout(&told).contains("on none of the 150 rows evaluated here"),
        "{}",
        stdout(&told)
    );
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
    let arguments = [
        "train",
        "trials",
        text(&data),
        "--recipe",
        recipe,
        "--out",
        model,
    ];
    let trained = output([&arguments[..], &["--format", "json"]].concat());
    assert_eq!(code(&trained), 0, "{}", stderr(&trained));
    let split = json(&trained)["split"].clone();
    let of = |part: &str| PathBuf::from(split[part][0].as_str().unwrap());
    let eval = |path: &Path| {
        let arguments = ["eval", "--model", model, text(path), "--resamples", "0"];
        let done = output([&arguments[..], &["--horizons", "none", "--format", "json"]].concat());
        assert_eq!(code(&done), 0, "{}", stderr(&done));
        (json(&done)["evaluations"][0].clone(), stderr(&done))
    };

    // 8 of 10 trials of 75 rows were trained on or chose the epoch: the other two are the headline.
    let (whole, told) = eval(&data);
    assert_eq!(whole["models"][0]["trained_on"]["rows"], 8 * 75, "{whole}");
    assert_eq!(whole["all"]["rows"], 2 * 75);
    assert_eq!(whole["trained_on"]["rows"], 8 * 75);
    assert_eq!(whole["scored_rows"], "not_trained_on");
    assert!(
        told.contains("warning") && told.contains("80.0 %"),
        "{told}"
    );

    let renamed = folder.path().join("new name.csv");
    fs::copy(of("training"), &renamed).unwrap();
    let capture = fleet.path("played.mcap");
    let mut import = fleet.joulebus("import");
    import.arg(of("training")).arg("-o").arg(&capture);
    let imported = import.output().unwrap();
    assert_eq!(code(&imported), 0, "{}", stderr(&imported));
    for path in [renamed, capture, of("validation")] {
        let (found, told) = eval(&path);
        assert_eq!(
            found["models"][0]["trained_on"]["share"],
            1.0,
            "{}",
            path.display()
        );
        assert_eq!(found["scored_rows"], "trained_on");
        assert!(told.contains("100.0 %"), "{told}");
    }
    let (found, told) = eval(&of("held_out"));
    assert_eq!(found["models"][0]["trained_on"]["rows"], 0);
    assert!(!told.contains("warning"), "{told}");
}

#[test]
fn baselines_can_be_fitted_on_given_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 4, 80);
    let at = |name: &str| data.join(name);
    let (ice, sand, more) = (at("ice_01.csv"), at("sand_00.csv"), at("sand_02.csv"));
    let asked = [
        "eval",
        "--model",
        MODELS[1],
        text(&ice),
        "--format",
        "json",
        "--fit",
        text(&sand),
        text(&more),
    ];
    let report = json(&output(asked));
    let evaluation = &report["evaluations"][0];
    assert_eq!(evaluation["design"]["fitted_rows"], 150);
    assert_eq!(evaluation["baselines"][1]["line"]["rows"], 150);
    assert!(
        evaluation["all"]["forecasters"][0]["r2"]["lo"].is_null(),
        "one block"
    );
    let copy = at("copy.csv");
    std::fs::copy(&ice, &copy).unwrap();
    for again in [&ice, &copy] {
        let arguments = [text(&ice), "--fit", text(again)];
        let twice = output([&["eval", "--model", MODELS[1]], &arguments[..]].concat());
        assert_eq!(code(&twice), 2);
        assert!(
            stderr(&twice).contains("must not be scored on"),
            "{}",
            stderr(&twice)
        );
    }
}

#[test]
fn a_usage_error_lists_the_allowed_values() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 2, 40);
    for (arguments, says) in [
        (vec!["--horizons", "1,301"], "1 to 300"),
        (vec!["--horizons", "10,3"], "ascending"),
        (vec!["--horizons", "soon"], "whole numbers"),
        (vec!["--split", "trial"], "at least 3"),
        (vec!["--split", "row"], "trial"),
        (vec!["--split", "time", "--held-out", "0.9"], "less than 1"),
        (vec!["--held-out", "0.2"], "--split"),
        (vec!["--confidence", "1"], "below 1"),
        (vec!["--origins-every", "0"], "1 row or more"),
    ] {
        let refused =
            output([&["eval", "--model", MODELS[0], text(&data)], &arguments[..]].concat());
        assert_eq!(code(&refused), 2, "{arguments:?}: {}", stderr(&refused));
        assert!(
            stderr(&refused).contains(says),
            "{arguments:?}: {}",
            stderr(&refused)
        );
        assert_eq!(stdout(&refused), "");
    }
}

#[test]
fn platforms_of_a_config_are_evaluated_separately() {
    let fleet = Fleet::new();
    let one = fleet.recording("a.csv", 200);
    // A rover publishes no velocities.
    let other = fleet.path("b.csv");
    let rows =
        (0..90).map(|row| format!("{:.4},{}\n", f64::from(row) / 30.0, 10_000 + row % 7 * 100));
    fs::write(
        &other,
        format!("timestamp_s,power_mW\n{}", rows.collect::<String>()),
    )
    .unwrap();
    let mut eval = fleet.joulebus("eval --format json");
    eval.arg(format!("{}@gternal", one.display()));
    eval.arg(format!("{}@rover", other.display()));
    let report = json(&eval.output().unwrap());
    let platforms: Vec<_> = report["evaluations"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| &one["platform"])
        .collect();
    assert_eq!(platforms, ["gternal", "rover"]);
    assert_eq!(
        (&report["robots"][0]["robot"], &report["robots"][1]["robot"]),
        (&0.into(), &100.into())
    );
}

#[test]
fn a_comparison_shows_differences_and_exits_with_3_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 24, 60);
    let compare = |old: &str, new: &str, more: &[&str]| {
        let asked = [
            "model",
            "compare",
            old,
            new,
            text(&data),
            "--resamples",
            "200",
        ];
        output([&asked[..], more].concat())
    };
    let forwards = compare(MODELS[0], MODELS[1], &["--format", "json"]);
    let backwards = compare(MODELS[1], MODELS[0], &["--format", "json"]);
    let (forwards, backwards) = (json(&forwards), json(&backwards));
    let all = |report: &Value| report["comparisons"][0]["all"].clone();
    let difference = |report: &Value| all(report)["mae_w"]["value"].as_f64().unwrap();
    assert!((difference(&forwards) + difference(&backwards)).abs() < 1e-12);
    assert!(difference(&forwards) != 0.0);
    assert_eq!(
        forwards["comparisons"][0]["trials"]
            .as_array()
            .unwrap()
            .len(),
        24
    );
    let verdicts =
        [&forwards, &backwards].map(|report| all(report)["verdict"].as_str().unwrap().to_owned());
    for (report, (old, new)) in verdicts
        .iter()
        .zip([(MODELS[0], MODELS[1]), (MODELS[1], MODELS[0])])
    {
        let is_worse = report == "worse";
        assert_eq!(code(&compare(old, new, &[])), 0, "{report}");
        assert_eq!(
            code(&compare(old, new, &["--fail-worse"])),
            if is_worse { 3 } else { 0 }
        );
    }
    assert!(
        verdicts.contains(&"worse".to_owned()),
        "two models that differ much: {verdicts:?}"
    );
    let same = compare(MODELS[0], MODELS[0], &["--fail-worse"]);
    assert_eq!(code(&same), 0);
    assert!(stdout(&same).contains("undecided"), "{}", stdout(&same));
    for said in [
        "old: model",
        "By group",
        "By robot",
        "By trial",
        "new − old",
        "paired",
    ] {
        assert!(stdout(&same).contains(said), "{said}: {}", stdout(&same));
    }
}

/// Makes the parts of an evaluation in processes that run at once. Returns their files.
fn parts(asked: &[&str], folder: &Path, of: usize) -> Vec<PathBuf> {
    let started = (1..=of).map(|number| {
        let file = folder.join(format!("{number}-of-{of}.part"));
        let part = format!("{number}/{of}");
        let mut command = joulebus(asked);
        let command = command.args(["--partition", &part, "-o", text(&file)]);
        (file, command.stdout(std::process::Stdio::null()).spawn())
    });
    let started: Vec<_> = started.collect();
    let ended = started.into_iter().map(|(file, child)| {
        assert!(child.unwrap().wait().unwrap().success(), "{file:?}");
        file
    });
    ended.collect()
}

fn merge(files: &[PathBuf], format: &str) -> std::process::Output {
    let arguments = ["eval", "--merge", "--format", format].map(PathBuf::from);
    output(arguments.iter().chain(files))
}

#[test]
fn parts_of_an_evaluation_by_several_processes_merge_into_the_report_of_one_run_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 5, 150);
    for options in [
        &["--energy"][..],
        &[
            "--split",
            "trial",
            "--held-out",
            "0.5",
            "--horizons",
            "none",
        ],
    ] {
        let asked = [&["eval", "--model", MODELS[0], text(&data)], options].concat();
        for format in ["text", "json"] {
            let whole = output(asked.iter().chain(&["--format", format]));
            assert_eq!(code(&whole), 0, "{}", stderr(&whole));
            for of in [1, 2, 3, 7] {
                let folder = tempfile::tempdir().unwrap();
                let mut files = parts(&asked, folder.path(), of);
                // Schedulers end in any order.
                files.reverse();
                let merged = merge(&files, format);
                assert_eq!(code(&merged), 0, "{}", stderr(&merged));
                assert_eq!(stdout(&merged), stdout(&whole), "{of} parts");
                assert_eq!(stderr(&merged), stderr(&whole), "{of} parts");
            }
        }
    }
}

#[test]
fn parts_of_two_platforms_merge_into_the_report_of_one_run_to_the_bit() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 3, 120);
    let (config, data) = (fleet.config(), text(&data).to_owned());
    let (gternal, rover) = (format!("{data}@gternal"), format!("{data}@rover"));
    let asked = ["eval", "--config", text(&config), &gternal, &rover];
    let whole = output(asked.iter().chain(&["--format", "json"]));
    assert_eq!(code(&whole), 0, "{}", stderr(&whole));
    let files = parts(&asked, folder.path(), 4);
    assert_eq!(stdout(&merge(&files, "json")), stdout(&whole));
}

#[test]
fn parts_that_are_missing_twice_there_damaged_or_of_other_evaluations_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 3, 120);
    let asked = ["eval", "--model", MODELS[0], text(&data)];
    let [first, second, third]: [PathBuf; 3] = parts(&asked, folder.path(), 3).try_into().unwrap();
    let refused = |files: &[&PathBuf], wanted: i32, why: &str| {
        let files: Vec<PathBuf> = files.iter().map(|file| (*file).clone()).collect();
        let found = merge(&files, "text");
        let said = stderr(&found);
        assert!(code(&found) == wanted && said.contains(why), "{said}");
        assert_eq!(stdout(&found), "");
    };
    refused(&[&first, &third], 2, "parts 2 of 3 are missing");
    refused(
        &[&first, &second, &second, &third],
        2,
        "name each part once",
    );

    let seed = [&asked[..], &["--seed", "1"]].concat();
    let elsewhere = tempfile::tempdir().unwrap();
    let others = parts(&seed, elsewhere.path(), 3);
    refused(&[&first, &others[1], &third], 2, "different evaluations");
    let two = parts(&asked, elsewhere.path(), 2);
    refused(&[&first, &second, &two[1]], 2, "is one of 3");

    let whole = fs::read(&second).unwrap();
    let bad = folder.path().join("bad.part");
    for length in (0..whole.len())
        .step_by(whole.len() / 16)
        .chain([whole.len() - 1])
    {
        fs::write(&bad, &whole[..length]).unwrap();
        let why = if length < 16 {
            "is no part"
        } else {
            "is damaged"
        };
        refused(&[&first, &bad, &third], 1, why);
    }
    for at in (16..whole.len()).step_by(whole.len() / 16) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        fs::write(&bad, bytes).unwrap();
        refused(&[&first, &bad, &third], 1, "is damaged");
    }
    refused(&[&data.join("ice_01.csv")], 1, "is no part");

    // Existing files are not replaced.
    let again = output(
        asked
            .iter()
            .chain(&["--partition", "2/3", "-o", text(&second)]),
    );
    assert!(
        code(&again) == 1 && stderr(&again).contains("exists"),
        "{}",
        stderr(&again)
    );
    assert_eq!(fs::read(&second).unwrap(), whole);
}

#[test]
fn the_script_reports_what_one_run_does_and_leaves_nothing_when_a_part_fails() {
    let folder = tempfile::tempdir().unwrap();
    let data = recordings(folder.path(), 3, 120);
    let rooms = folder.path().join("tmp");
    fs::create_dir(&rooms).unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/eval_parts.sh");
    let run = |arguments: &[&str]| {
        let mut command = std::process::Command::new(script);
        let command = command.args(arguments).env("TMPDIR", &rooms);
        let command = command.env("JOULEBUS", env!("CARGO_BIN_EXE_joulebus"));
        let ended = command.output().unwrap();
        assert_eq!(fs::read_dir(&rooms).unwrap().count(), 0);
        ended
    };
    let asked = ["--model", MODELS[0], text(&data)];
    let whole = output(["eval"].iter().chain(&asked));
    // More parts than recordings.
    let found = run(&[&["5"], &asked[..]].concat());
    assert_eq!(code(&found), 0, "{}", stderr(&found));
    assert_eq!(stdout(&found), stdout(&whole));

    let failed = run(&["2", "--model", "/nowhere.safetensors", text(&data)]);
    assert_eq!((code(&failed), stdout(&failed).as_str()), (1, ""));
    assert!(stderr(&failed).contains("/nowhere.safetensors"));
    assert_eq!(code(&run(&["0", text(&data)])), 2);
}
