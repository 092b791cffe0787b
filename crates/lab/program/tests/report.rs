//! `joulebus report`: one command writes a directory with one page.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};

use joulebus_testkit::{Ended, assert_contains, run};

fn output<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Ended {
    let arguments = arguments.into_iter().map(|word| word.as_ref().to_owned());
    let words = [OsString::from("report")].into_iter().chain(arguments);
    run(env!("CARGO_BIN_EXE_joulebus-lab"), words)
}

/// A recording of `rows` rows at 30 Hz whose power changes in each of them.
fn recording(folder: &Path, name: &str, rows: u32) -> PathBuf {
    let mut text = "timestamp_s,power_mW,v_cmd_mps,omega_cmd_radps\n".to_owned();
    for row in 0..rows {
        let time_s = f64::from(row) / 30.0;
        let power_mw = 3_600 + row % 97 + 10 * (row % 7);
        text += &format!("{time_s},{power_mw},0.1,{}\n", f64::from(row % 5) * 0.1);
    }
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_split_reports_on_what_was_held_out() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    fs::create_dir(&data).unwrap();
    for trial in 0..6 {
        recording(&data, &format!("t_{trial}.csv"), 300 + 10 * trial);
    }
    let report = |more: &[&str]| {
        let out = folder.path().join("report");
        let (data, out) = (data.to_str().unwrap(), out.to_str().unwrap());
        let arguments = [data, "--model", "builtin:gternal-sim", "-o", out];
        output([&arguments[..], more].concat()).exits(0);
        fs::read_to_string(Path::new(out).join("report.txt")).unwrap()
    };
    let text = report(&["--split", "trial", "--held-out", "0.3", "--seed", "3"]);
    assert!(text.contains("split by trial"), "{text}");
    assert_contains(&text, ["seed 3", "30 % held out"]);
    assert!(text.contains(", on 2 recordings"), "{text}");
    let text = report(&["--split", "trial", "--leave-out", data.join("t_4.csv").to_str().unwrap()]);
    assert_contains(&text, [", on 1 recordings", "t_4.csv held out"]);
    let text = report(&["--leave-out", "t_4.csv"]);
    assert_contains(&text, [", on 1 recordings", "left out: t_4.csv", "mean so far", "ridge"]);
    output(
        format!("{} --model builtin:gternal-sim --split row -o x", data.to_str().unwrap())
            .split(' '),
    )
    .exits(2);
}

#[test]
fn recordings_are_reported_without_a_model_and_before_its_scores() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = ["a.csv", "b.csv"].map(|name| recording(folder.path(), name, 300));
    let report = |more: &[&str]| {
        let out = folder.path().join("report");
        let mut arguments: Vec<&OsStr> = recordings.iter().map(|path| path.as_os_str()).collect();
        arguments.extend(["-o".as_ref(), out.as_os_str()]);
        arguments.extend(more.iter().map(OsStr::new));
        output(arguments).exits(0).text()
    };
    let text = report(&[]);
    let parts =
        "Energy in 2 recordings | Energy per metre: 0.0102 Wh | 600 of 600 rows | --battery-wh";
    assert_contains(&text, parts.split(" | "));
    assert!(!text.contains("persistence"), "{text}");
    let text = report(&["--battery-wh", "20", "--model", "builtin:gternal-sim"]);
    assert!(text.contains("A battery of 20.0 Wh lasts 5.4"), "{text}");
    let [usage, scores] = ["The runs, the worst first", "All recordings together"]
        .map(|caption| text.find(caption).unwrap());
    assert!(usage < scores, "{text}");
}

#[test]
fn one_command_runs_the_simulated_experiments() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("report");
    let arguments = [
        "--format",
        "json",
        "--simulated",
        "--samples",
        "700",
        "--max-epochs",
        "2",
        "--seed",
        "4",
        "-o",
        out.to_str().unwrap(),
    ];
    let made = output(arguments).exits(0);
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("Every number here is of simulated robots"));
    let written = fs::read_to_string(out.join("report.json")).unwrap();
    let written: serde_json::Value = serde_json::from_str(&written).unwrap();
    assert_eq!(made.json(), written, "stdout and the file say the same");
    assert!(fs::metadata(out.join("report.txt")).unwrap().len() > 0);

    // Its network is an ordinary model, usable for reports on recordings.
    let recordings = ["a.csv", "b.csv"].map(|name| recording(folder.path(), name, 300));
    let model = out.join("network.safetensors");
    let second = folder.path().join("second");
    let mut arguments = vec!["--model", model.to_str().unwrap()];
    arguments.extend(["-o", second.to_str().unwrap()]);
    arguments.extend(recordings.iter().map(|path| path.to_str().unwrap()));
    let made = output(arguments).exits(0);
    let text = made.text();
    let parts = "network | persistence | AR(5) + velocities | trained on simulated robots";
    assert_contains(&text, parts.split(" | "));
    assert!(made.errors().contains("report.html"), "{}", made.errors());
}

#[test]
fn invalid_requests_are_refused_before_the_evaluation() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recording(folder.path(), "a.csv", 100);
    let recording = recording.to_str().unwrap();
    let out = folder.path().join("report");
    let out = out.to_str().unwrap();
    for (arguments, message, expected) in [
        (vec!["-o", out], "PATH", 2),
        (vec![recording, "--battery-wh", "0", "-o", out], "--battery-wh", 2),
        (vec!["--simulated", recording, "-o", out], "--simulated", 2),
        (vec![recording, "--model", "none.safetensors", "-o", out], "none.safetensors", 1),
        (vec!["--simulated", "--samples", "9", "-o", out], "100 or more", 1),
    ] {
        let refused = output(&arguments);
        assert_eq!(refused.exit_code(), expected, "{arguments:?}: {}", refused.errors());
        assert!(refused.errors().contains(message), "{message}: {}", refused.errors());
        assert!(refused.text().is_empty());
    }
}
