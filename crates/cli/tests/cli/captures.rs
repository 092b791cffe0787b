//! `joulebus import`, `cat`, `info`, `doctor FILE` and `recover` on captures and foreign
//! recordings.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use joulebus_capture_format::{Attachments, CaptureSettings, Writer};
use joulebus_testkit::recordings::shared;

use crate::fleet::{Fleet, code, json, output, stderr, stdout};
use joulebus_testkit::says;

fn run(arguments: &[&str]) -> Output {
    output(arguments)
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// A capture of two recordings, and the samples in it.
pub(crate) fn capture(fleet: &Fleet, rows: u32) -> (PathBuf, u64) {
    let path = fleet.path("trials.mcap");
    let mut import = fleet.joulebus("import --format json");
    import.arg("-o").arg(&path);
    import.args(["a.csv", "b.csv"].map(|name| fleet.recording(name, rows)));
    let imported = import.output().unwrap();
    assert_eq!(code(&imported), 0, "{}", stderr(&imported));
    let samples = json(&imported)["written"][0]["rows"].as_u64().unwrap();
    assert_eq!(samples, u64::from(2 * rows));
    (path, samples)
}

#[test]
fn a_damaged_capture_is_diagnosed_and_recovered() {
    let fleet = Fleet::new();
    let (whole, samples) = capture(&fleet, 300);
    let info = run(&["info", &text(&whole), "--format", "json"]);
    assert_eq!(code(&info), 0, "{}", stdout(&info));
    let info = json(&info)["files"][0].clone();
    assert_eq!(info["statistics"]["state"], "agree");
    let messages = info["messages"].as_u64().unwrap();
    assert_eq!(info["channels"][0]["topic"], "joulebus/cli/samples");
    assert!(
        info["joulebus"]["imported"]
            .as_str()
            .unwrap()
            .contains("0 a, 1 b"),
        "{info}"
    );
    assert_eq!(code(&run(&["doctor", &text(&whole)])), 0);

    let lines = stdout(&run(&["cat", &text(&whole), "--format", "ndjson"]));
    assert_eq!(lines.lines().count() as u64, messages);
    let mut rows = 0;
    for line in lines.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        rows += line["value"]["samples"].as_array().unwrap().len() as u64;
    }
    assert_eq!(rows, samples);
    // A topic that is not there, beside one that is; and an expression that matches none.
    for asked in [
        ["--topics", "joulebus/cli/samples", "joulebus/cli/sample"].as_slice(),
        &["-e", "budget"],
    ] {
        let refused = run(&[&["cat", text(&whole).as_str()], asked].concat());
        assert_eq!(code(&refused), 1, "{asked:?}");
        let why = stderr(&refused);
        let last = asked[asked.len() - 1];
        says(&why, [last, "there are joulebus/cli/samples"]);
    }
    let found = run(&["cat", &text(&whole), "-e", "sampl.s$"]);
    assert_eq!(
        (code(&found), stdout(&found).lines().count() as u64),
        (0, messages)
    );
    let table = stdout(&run(&["cat", &text(&whole), "--format", "csv"]));
    assert_eq!(table.lines().count() as u64, samples + 1);
    assert!(
        table.lines().next().unwrap().contains("samples.power_w"),
        "{table}"
    );

    let cut = fleet.path("cut.mcap");
    let bytes = fs::read(&whole).unwrap();
    fs::write(&cut, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let doctor = run(&["doctor", &text(&cut)]);
    assert_eq!(code(&doctor), 3, "{}", stdout(&doctor));
    says(&stdout(&doctor), ["the file ends within"]);
    assert!(stdout(&doctor).contains("joulebus recover"));
    let again = fleet.path("again.mcap");
    let recover = run(&[
        "recover",
        &text(&cut),
        "-o",
        &text(&again),
        "--format",
        "json",
    ]);
    assert_eq!(code(&recover), 3, "{}", stderr(&recover));
    let recovered = json(&recover);
    let kept = recovered["messages"]["recovered"].as_u64().unwrap();
    assert!(
        kept < messages && recovered["lost_unknown"] == true,
        "{recovered}"
    );
    assert_eq!(code(&run(&["doctor", &text(&again)])), 0);
    let shown = json(&run(&["info", &text(&again), "--format", "json"]));
    assert_eq!(shown["files"][0]["messages"], kept);
    let twice = run(&["recover", &text(&cut), "-o", &text(&again)]);
    assert_eq!(code(&twice), 1, "{}", stderr(&twice));
    assert!(stderr(&twice).contains("exists"));
}

#[test]
fn a_recovery_that_cannot_be_written_names_file_and_cause_and_leaves_what_was_there() {
    let fleet = Fleet::new();
    let (whole, _) = capture(&fleet, 300);
    let out = fleet.path("again.mcap");
    // A link that leads nowhere is somebody's, too.
    std::os::unix::fs::symlink(fleet.path("nowhere"), &out).unwrap();
    let refused = run(&["recover", &text(&whole), "-o", &text(&out)]);
    assert_eq!(code(&refused), 1, "{}", stderr(&refused));
    assert!(stderr(&refused).contains("exists"), "{}", stderr(&refused));
    fs::remove_file(&out).expect("the link is left as it was");
    // As on a full disk: four blocks of 1,024 bytes.
    let mut limited = Command::new("bash");
    limited.args(["-c", "ulimit -f 4; exec \"$@\"", "bash"]);
    limited.arg(joulebus::<&str>([]).get_program());
    limited.args(["recover", &text(&whole), "-o", &text(&out)]);
    let failed = limited.output().unwrap();
    assert_eq!(code(&failed), 1, "{}", stderr(&failed));
    for named in [text(&out), "File too large".to_owned()] {
        assert!(stderr(&failed).contains(&named), "{}", stderr(&failed));
    }
    assert!(!out.exists(), "part of a file is left");
}

#[test]
fn a_capture_decides_neither_where_directories_are_made_nor_which_files_are_read() {
    let fleet = Fleet::new();
    let (made, model) = (fleet.path("made"), fleet.path("model.safetensors"));
    fs::write(&model, "somebody's").unwrap();
    let (made, model) = (text(&made), text(&model));
    let own = fleet.path("own.toml");
    fs::write(&own, joulebus_config::builtin_platform("rover").unwrap()).unwrap();
    let other = |file: &str| format!("[[platform]]\nfile = \"{file}\"\nrobots = [20]");
    for (domain, platform, verb, named) in [
        (
            &*format!("root = \"{made}\""),
            "",
            "--no-wait",
            "domain.root",
        ),
        (
            "root = \"/dev/shm/../tmp/x\"",
            "",
            "--no-wait",
            "domain.root",
        ),
        (
            "",
            &*format!("model = \"{model}\""),
            "--verify",
            "is not attached",
        ),
        (
            "",
            "model = \"models/../config.toml\"",
            "--verify",
            "is not attached",
        ),
        ("", &*other(&text(&own)), "--no-wait", "is not attached"),
        (
            "",
            &*other("models/../own.toml"),
            "--verify",
            "is not attached",
        ),
    ] {
        let config = format!(
            "[fleet]\nname = \"cli\"\n[domain]\n{domain}\n[[platform]]\nfile = \"builtin:gternal\"\n\
             robots = [\"0-9\"]\n{platform}\n"
        );
        let mut attachments = Attachments::default();
        attachments.add("cli/config.toml".to_owned(), "", config.into_bytes());
        attachments.add("cli/models/0-x".to_owned(), "", Vec::new());
        let path = fleet.path("foreign.mcap");
        let _ = fs::remove_file(&path);
        let writer = Writer::new(
            fs::File::create_new(&path).unwrap(),
            CaptureSettings::default(),
            &attachments,
        )
        .unwrap();
        writer.finish().unwrap();
        let refused = run(&["replay", &text(&path), verb]);
        assert_eq!(code(&refused), 2, "{named}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(named), "{}", stderr(&refused));
        assert!(!Path::new(&made).exists());
    }
}

#[test]
fn a_replay_with_no_wait_plays_to_its_end_without_a_worker() {
    let fleet = Fleet::new();
    let (file, samples) = capture(&fleet, 300);
    for rate in ["50", "max", "1000"] {
        let verb = format!(
            "replay {} --rate {rate} --no-wait --format json",
            file.display()
        );
        let played = fleet.output(&verb);
        // Frames sent without a worker are lost, as documented for the option.
        assert!(matches!(code(&played), 0 | 3), "{}", stderr(&played));
        assert_eq!(json(&played)["samples"], samples, "rate {rate}");
        assert!(!stderr(&played).contains("waiting"), "{}", stderr(&played));
        assert!(fleet.stale_files().is_empty());
    }
}

#[test]
fn an_existing_file_is_refused_with_a_remedy() {
    let fleet = Fleet::new();
    let file = fleet.path("run.mcap");
    fs::write(&file, "precious").unwrap();
    for verb in ["record -o", "run --record"] {
        let refused = fleet.output(&format!("{verb} {}", file.display()));
        assert_eq!(code(&refused), 1, "{verb}");
        says(&stderr(&refused), ["--resume"]);
        assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
        assert!(fleet.stale_files().is_empty());
    }
}

#[test]
fn a_file_that_is_not_a_capture_is_refused() {
    let fleet = Fleet::new();
    let file = fleet.recording("a.csv", 10);
    for verb in ["info", "doctor", "cat"] {
        let refused = run(&[verb, &text(&file)]);
        assert_eq!(code(&refused), 1, "{verb}");
        says(&stderr(&refused), ["an MCAP file begins with"]);
    }
    let form = run(&["info", &text(&file), "--format", "csv"]);
    assert_eq!(code(&form), 2);
    let result = fleet.path("x.mcap");
    let recover = run(&["recover", &text(&file), "-o", &text(&result)]);
    assert_eq!(code(&recover), 1);
    assert!(!result.exists());
}

#[test]
fn a_real_recording_is_imported_and_played() {
    let Some(file) = shared("mcap/couguv/SO_lastbag_mcap_0.mcap") else {
        return;
    };
    let fleet = Fleet::new();
    let trials = fleet.path("trials");
    let sign = ["--current", "discharge-positive"];
    let arguments = [
        "import",
        &text(&file),
        "-o",
        &text(&trials),
        sign[0],
        sign[1],
    ];
    let imported = run(&arguments);
    // Positions that are not numbers are reported and set the exit code.
    assert_eq!(code(&imported), 3, "{}", stderr(&imported));
    says(&stdout(&imported), ["its position is not a number"]);
    let dataset = trials.join("coug2.csv.gz");
    let info = json(&run(&["data", "info", &text(&dataset), "--format", "json"]));
    let trial = &info["trials"][0];
    let rows = trial["rows"].as_u64().unwrap();
    assert!((1190..=1200).contains(&rows), "{trial}");
    let rate_hz = trial["rate_hz"].as_f64().unwrap();
    assert!((9.5..10.5).contains(&rate_hz), "{trial}");
    let missing = trial["missing_columns"].to_string();
    says(&missing, ["v_cmd_mps", "omega_cmd_radps", "x_m", "y_m"]);
    assert!(!missing.contains("voltage_mV"), "{missing}");
    assert!(trial["least_power_w"].as_f64().unwrap() > 0.0, "{trial}");
    let mut play =
        fleet.joulebus("publish trial --no-wait --rate 10000 --first-robot 100 --format json");
    let played = play.arg(&dataset).output().unwrap();
    assert_eq!(
        json(&played)["trials"][0]["samples"],
        rows,
        "{}",
        stderr(&played)
    );
}

#[test]
fn a_recording_without_a_battery_exits_with_1_and_lists_its_topics() {
    let Some(folder) = shared("mcap/rosbag2") else {
        return;
    };
    let fleet = Fleet::new();
    for file in fs::read_dir(folder).unwrap() {
        let file = file.unwrap().path();
        let out = fleet.path("out");
        let refused = run(&["import", &text(&file), "-o", &text(&out)]);
        assert_eq!(code(&refused), 1, "{}", stderr(&refused));
        says(&stderr(&refused), ["no robot", "other types"]);
        assert!(stdout(&refused).is_empty(), "{}", stdout(&refused));
        assert!(!out.exists());
    }
}
