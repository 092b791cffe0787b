//! `joulebus data` and `joulebus analyze`.

use super::fleet::{Exits as _, Fleet, code, done, json, output, stderr, stdout};
use joulebus_testkit::assert_contains;

#[test]
fn faults_of_recordings_are_reported_with_file_and_row_and_exit_code_3() {
    let fleet = Fleet::new();
    let sound = fleet.recording("sound.csv", 200);
    let text = std::fs::read_to_string(&sound).unwrap();
    let spoiled = sound.with_file_name("spoiled.csv");
    let lines: Vec<&str> = text.lines().collect();
    std::fs::write(&spoiled, [&lines[..50], &lines[60..]].concat().join("\n") + "\n").unwrap();
    let folder = sound.parent().unwrap().to_str().unwrap();

    let good = output(["data", "check", sound.to_str().unwrap()]);
    assert_eq!(code(&good), 0, "{}{}", stdout(&good), stderr(&good));
    assert!(stdout(&good).contains("no fault"), "{}", stdout(&good));

    let bad = output(["data", "check", folder]).exits(3);
    let printed = stdout(&bad);
    assert_contains(&printed, ["gaps: 1 in 1 files", "spoiled.csv: row 51"]);
    assert!(stderr(&bad).contains("are ignored"), "the config beside them: {}", stderr(&bad));

    let report = json(&output(["data", "check", folder, "--format", "json"]));
    assert_eq!((&report["sound"], &report["files"]), (&false.into(), &2.into()));
    assert_eq!(report["findings"][0]["kind"], "gap");
    assert_eq!(report["findings"][0]["places"][0]["row"], 51);

    output(["data", "check", &format!("{folder}/*.npy")]).exits(2);
}

#[test]
fn recordings_are_converted_and_resampled_only_on_request() {
    let fleet = Fleet::new();
    let from = fleet.recording("run.csv", 300);
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let convert = |from: &str, more: &[&str]| {
        let words = ["data", "convert", from, "--format", "json"];
        output(words.iter().chain(more))
    };
    let from = from.to_str().unwrap();
    let array = path("a.npy");
    convert(from, &["--out", &array]).exits(0);
    let again = convert(from, &["--out", &array]);
    assert_eq!(code(&again), 1, "a file was overwritten");
    let back = path("b.csv");
    assert_eq!(code(&convert(&array, &["--out", &back])), 0);
    let third = path("c.npy");
    assert_eq!(code(&convert(&back, &["--out", &third])), 0);
    assert_eq!(std::fs::read(&array).unwrap(), std::fs::read(&third).unwrap());

    let thin = path("thin");
    let grid = ["--to", "csv.gz", "--resample", "mean", "--rate", "10", "--out", &thin];
    let made = json(&convert(from, &grid));
    assert_eq!(made["resample"]["method"], "mean");
    assert_eq!(made["files"][0]["rows"], 100, "{made}");
    assert!(made["files"][0]["file"].as_str().unwrap().ends_with("run.csv.gz"));
    for (words, wanted) in [
        (vec!["--rate", "10", "--out", "x.npy"], "--resample"),
        (vec!["--drop", "power_mW", "--out", "x.npy"], "power_mW"),
    ] {
        let refused = convert(from, &words);
        assert_eq!(code(&refused), 2, "{words:?}");
        assert!(stderr(&refused).contains(wanted), "{}", stderr(&refused));
    }
}

#[test]
fn an_analysis_reports_its_split_and_held_readings() {
    let fleet = Fleet::new();
    for trial in 0..4 {
        fleet.recording(&format!("run_{trial}.csv"), 240 + 10 * trial);
    }
    let pattern = fleet.path("run_*.csv");
    let pattern = pattern.to_str().unwrap();
    let text = done(["analyze", pattern, "--rate", "60"]);
    let printed = stdout(&text);
    let parts = "native: 1020 rows | held at 60 Hz | split by trial | persistence | \
        % of these readings repeat";
    assert_contains(&printed, parts.split(" | "));
    let report = json(&output(["analyze", pattern, "--rate", "60", "--format", "json"]));
    let series = report["series"].as_array().unwrap();
    assert_eq!(series[0]["held_share"], 0.0);
    let held = series[1]["held_share"].as_f64().unwrap();
    assert!((held - 0.5).abs() < 0.01, "{held}");
    assert_eq!(series[1]["grid"]["method"], "hold");
    output(["analyze", pattern, "--split", "group"]).exits(2);
}
