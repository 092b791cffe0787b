//! `joulebus report`: one command, one directory, one page.

use std::fs;

use super::fleet::{Fleet, code, json, output, stderr, stdout};

#[test]
fn a_newcomer_gets_the_simulated_course_with_one_command() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("report");
    let arguments = [
        "--format",
        "json",
        "report",
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
    let made = output(arguments);
    assert_eq!(code(&made), 0, "{}", stderr(&made));
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("Every number here is of simulated robots"));
    assert!(!page.contains("http"));
    let written = fs::read_to_string(out.join("report.json")).unwrap();
    let written: serde_json::Value = serde_json::from_str(&written).unwrap();
    assert_eq!(json(&made), written, "stdout and the file say the same");
    for file in [
        "report.txt",
        "figures/figure-1-power.png",
        "figures/figure-5-robots.svg",
    ] {
        assert!(fs::metadata(out.join(file)).unwrap().len() > 0, "{file}");
    }

    // Its network is a model like any other, and recordings are reported with it.
    let fleet = Fleet::new();
    let recordings = ["a.csv", "b.csv"].map(|name| fleet.recording(name, 300));
    let model = out.join("network.safetensors");
    let second = folder.path().join("second");
    let mut arguments = vec!["report", "--model", model.to_str().unwrap()];
    arguments.extend(["-o", second.to_str().unwrap()]);
    arguments.extend(recordings.iter().map(|path| path.to_str().unwrap()));
    let made = output(arguments);
    assert_eq!(code(&made), 0, "{}", stderr(&made));
    let said = stdout(&made);
    for name in [
        "network",
        "persistence",
        "AR(5) + velocities",
        "trained on simulated robots",
    ] {
        assert!(said.contains(name), "{name}: {said}");
    }
    assert!(stderr(&made).contains("report.html"), "{}", stderr(&made));
}

#[test]
fn what_cannot_be_reported_is_refused_before_the_work() {
    let fleet = Fleet::new();
    let recording = fleet.recording("a.csv", 100);
    let recording = recording.to_str().unwrap();
    let out = fleet.path("report");
    let out = out.to_str().unwrap();
    for (arguments, says, expected) in [
        (vec!["report", "-o", out], "PATH", 2),
        (vec!["report", recording, "-o", out], "--model", 2),
        (
            vec!["report", "--simulated", recording, "-o", out],
            "--simulated",
            2,
        ),
        (
            vec![
                "report",
                recording,
                "--model",
                "none.safetensors",
                "-o",
                out,
            ],
            "none.safetensors",
            1,
        ),
        (
            vec!["report", "--simulated", "--samples", "9", "-o", out],
            "100 or more",
            1,
        ),
    ] {
        let refused = output(&arguments);
        assert_eq!(
            code(&refused),
            expected,
            "{arguments:?}: {}",
            stderr(&refused)
        );
        assert!(
            stderr(&refused).contains(says),
            "{says}: {}",
            stderr(&refused)
        );
        assert!(stdout(&refused).is_empty());
    }
}
