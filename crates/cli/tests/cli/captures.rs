//! `joulebus import`, `info`, `doctor FILE` and `recover` on captures and foreign recordings.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use joulebus_capture_format::{Attachments, CaptureSettings, Entry, Reader, Writer};
use joulebus_testkit::recordings::shared;

use crate::fleet::{Exits as _, Fleet, Program, at, code, joulebus, json, output, stderr, stdout};
use joulebus_testkit::assert_contains;
use joulebus_wire::Samples;
use rustix::process::Signal;

/// The program with the words of a line.
fn run(line: impl AsRef<str>) -> Output {
    output(line.as_ref().split_whitespace())
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
    let imported = import.output().unwrap().exits(0);
    let samples = json(&imported)["written"][0]["rows"].as_u64().unwrap();
    assert_eq!(samples, u64::from(2 * rows));
    (path, samples)
}

#[test]
fn a_damaged_capture_is_diagnosed_and_recovered() {
    let fleet = Fleet::new();
    let (whole, samples) = capture(&fleet, 300);
    let shown = text(&whole);
    let info = json(&run(format!("info {shown} --format json")).exits(0))["files"][0].clone();
    assert_eq!((&info["complete"], &info["errors"]), (&true.into(), &0.into()));
    let messages = info["messages"].as_u64().unwrap();
    assert_eq!(info["channels"][0]["topic"], "joulebus/cli/samples");
    assert_contains(&info["joulebus"]["imported"], ["0 a, 1 b"]);
    run(format!("doctor {shown}")).exits(0);

    let read: Vec<Entry> = Reader::open(&whole).unwrap().map(Result::unwrap).collect();
    let frames = read.iter().filter_map(|entry| entry.message.frame::<Samples>());
    assert_eq!(
        (read.len() as u64, frames.map(|frame| frame.rows.len() as u64).sum()),
        (messages, samples)
    );

    let cut = fleet.path("cut.mcap");
    let bytes = fs::read(&whole).unwrap();
    fs::write(&cut, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let doctor = run(format!("doctor {}", text(&cut))).exits(3);
    assert_contains(&stdout(&doctor), ["the file ends within", "joulebus recover"]);
    let again = text(&fleet.path("again.mcap"));
    let recover = format!("recover {} -o {again}", text(&cut));
    let recovered = json(&run(format!("{recover} --format json")).exits(3));
    let kept = recovered["messages"]["recovered"].as_u64().unwrap();
    assert!(kept < messages && recovered["lost_unknown"] == true, "{recovered}");
    run(format!("doctor {again}")).exits(0);
    let shown = json(&run(format!("info {again} --format json")));
    assert_eq!(shown["files"][0]["messages"], kept);
    assert_contains(&stderr(&run(recover).exits(1)), ["exists"]);
}

#[test]
fn a_recovery_that_cannot_be_written_names_file_and_cause_and_leaves_what_was_there() {
    let fleet = Fleet::new();
    let (whole, _) = capture(&fleet, 300);
    let out = fleet.path("again.mcap");
    // A link that leads nowhere is somebody's, too.
    std::os::unix::fs::symlink(fleet.path("nowhere"), &out).unwrap();
    let refused = run(format!("recover {} -o {}", text(&whole), text(&out))).exits(1);
    assert_contains(&stderr(&refused), ["exists"]);
    fs::remove_file(&out).expect("the link is left as it was");
    // As on a full disk: four blocks of 1,024 bytes.
    let mut limited = Command::new("bash");
    limited.args(["-c", "ulimit -f 4; exec \"$@\"", "bash"]);
    limited.arg(joulebus::<&str>([]).get_program());
    limited.args(["recover", &text(&whole), "-o", &text(&out)]);
    let failed = limited.output().unwrap().exits(1);
    assert_contains(&stderr(&failed), [text(&out).as_str(), "File too large"]);
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
    let (play, verify) = ("--no-wait", "--verify");
    let (root, model) = (format!("root = \"{made}\""), format!("model = \"{model}\""));
    let outside = "root = \"/dev/shm/../tmp/x\"";
    let beside = "model = \"models/../config.toml\"";
    for (domain, platform, verb, named) in [
        (&*root, "", play, "domain.root"),
        (outside, "", play, "domain.root"),
        ("", &*model, verify, "is not attached"),
        ("", beside, verify, "is not attached"),
        ("", &*other(&text(&own)), play, "is not attached"),
        ("", &*other("models/../own.toml"), verify, "is not attached"),
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
        let file = fs::File::create_new(&path).unwrap();
        let writer = Writer::new(file, CaptureSettings::default(), &attachments).unwrap();
        writer.finish().unwrap();
        let refused = run(format!("replay {} {verb}", text(&path))).exits(2);
        assert_contains(&stderr(&refused), [named]);
        assert!(!Path::new(&made).exists());
    }
}

/// Files of the program of 25 November 2026 (df6ba14): a capture of one robot with a keyframe and
/// two answers, and the ledger of 4 s.
#[test]
fn files_of_an_earlier_release_are_refused_by_name_or_go_on() {
    let earlier = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/earlier");
    let capture = text(&earlier.join("run.mcap"));
    let refused = stderr(&run(format!("replay --verify {capture}")).exits(1));
    assert_contains(
        &refused,
        ["run.mcap", "by rules 1", "with the version that recorded it (0.1.0)"],
    );
    let shown = json(&run(format!("info {capture} --format json")).exits(0));
    assert!(shown.is_object(), "{shown}");
    let fleet = Fleet::new();
    let ledger = fleet.path("ledger");
    fs::copy(earlier.join("ledger"), &ledger).unwrap();
    let config = fs::read_to_string(fleet.config()).unwrap();
    let saved = format!("checkpoint = {ledger:?}");
    let config = config.replace("checkpoint = \"\"", &saved);
    fs::write(fleet.config(), config.replace("\"cli\"", "\"lab\"")).unwrap();
    let mut worker = Program::start(fleet.joulebus("run"));
    worker.wait_for_stderr("ready:");
    fleet.output("publish sim --robots 1 --duration 1").exits(0);
    let shown = json(&fleet.output("watch --once --format json").exits(0));
    // 4 s at more than 2.5 W before, and 1 s now.
    let drawn_j = shown["robots"][0]["drawn_j"].as_f64().unwrap();
    assert!(drawn_j > 10.0, "{shown}");
    worker.end(Signal::TERM).exits(0);
}

#[test]
fn a_replay_with_no_wait_plays_to_its_end_without_a_worker() {
    let fleet = Fleet::new();
    let (file, samples) = capture(&fleet, 300);
    for rate in ["50", "max", "1000"] {
        let file = text(&file);
        let verb = format!("replay {file} --rate {rate} --no-wait --format json");
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
    let refused = fleet.output(&format!("record -o {}", file.display())).exits(1);
    assert_contains(&stderr(&refused), ["--resume"]);
    assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_worker_runs_whatever_becomes_of_its_recording() {
    // The same command again after a crash: the next part. No such folder: no recording, code 3.
    for (name, parts, wanted) in [("run.mcap", 2, 0), ("none/run.mcap", 0, 3)] {
        let fleet = Fleet::new();
        let run = || {
            let mut command = fleet.joulebus("run");
            command.arg("--record").arg(fleet.path(name));
            let mut program = Program::start(command);
            program.wait_for_stderr("ready:");
            program.end(Signal::TERM).exits(wanted)
        };
        run();
        let printed = stderr(&run());
        assert_eq!(printed.contains("nothing is recorded"), parts == 0, "{printed}");
        let there = |part: &str| fleet.path(part).exists();
        let found = ["run.mcap", "run_1.mcap"].map(there);
        assert_eq!(found, [parts > 0, parts > 1], "{printed}");
        assert!(fleet.stale_files().is_empty());
    }
}

#[test]
fn files_of_other_programs_are_refused_with_the_program_that_reads_them() {
    let Some(folder) = shared("mcap") else {
        return;
    };
    for (file, library) in
        [("couguv/SO_lastbag_mcap_0.mcap", "libmcap"), ("conformance/NoData/NoData.mcap", "\"\"")]
    {
        let file = folder.join(file);
        let name = text(&file);
        for verb in ["info", "doctor", "alarms"] {
            let refused = run(format!("{verb} {name}")).exits(1);
            let way = format!("`mcap {} {name}`", verb.replace("alarms", "info"));
            assert_contains(&stderr(&refused), ["no capture of joulebus", library, &way]);
            assert_eq!(stdout(&refused), "");
        }
    }
    // A capture whose beginning is damaged is still one.
    let fleet = Fleet::new();
    let (whole, _) = capture(&fleet, 300);
    let mut bytes = fs::read(&whole).unwrap();
    bytes[9..60].fill(0);
    fs::write(&whole, bytes).unwrap();
    let damaged = run(format!("doctor {}", text(&whole))).exits(3);
    assert_contains(&stdout(&damaged), ["FAIL", "joulebus recover"]);
}

#[test]
fn a_real_recording_is_imported_and_played() {
    let Some(file) = shared("mcap/couguv/SO_lastbag_mcap_0.mcap") else {
        return;
    };
    let fleet = Fleet::new();
    let trials = fleet.path("trials");
    let (file, out) = (text(&file), text(&trials));
    let imported = run(format!("import {file} -o {out} --current discharge-positive"));
    // Positions that are not numbers are reported and set the exit code.
    let imported = imported.exits(3);
    assert_contains(&stdout(&imported), ["its position is not a number"]);
    let dataset = trials.join("coug2.csv.gz");
    let info = json(&run(format!("data info {} --format json", text(&dataset))));
    let trial = &info["trials"][0];
    let rows = trial["rows"].as_u64().unwrap();
    assert!((1190..=1200).contains(&rows), "{trial}");
    let rate_hz = trial["rate_hz"].as_f64().unwrap();
    assert!((9.5..10.5).contains(&rate_hz), "{trial}");
    let missing = trial["missing_columns"].to_string();
    assert_contains(&missing, ["v_cmd_mps", "omega_cmd_radps", "x_m", "y_m"]);
    assert!(!missing.contains("voltage_mV"), "{missing}");
    assert!(trial["least_power_w"].as_f64().unwrap() > 0.0, "{trial}");
    let play = "publish trial --no-wait --rate 10000 --format json";
    let played = fleet.joulebus(play).arg(at(&dataset, "100")).output().unwrap();
    let played_rows = &json(&played)["trials"][0]["samples"];
    assert_eq!(*played_rows, rows, "{}", stderr(&played));
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
        let refused = run(format!("import {} -o {}", text(&file), text(&out))).exits(1);
        assert_contains(&stderr(&refused), ["no robot", "other types"]);
        assert!(stdout(&refused).is_empty(), "{}", stdout(&refused));
        assert!(!out.exists());
    }
}

#[test]
fn a_bags_folder_is_read_as_far_as_its_files_are_mcap_and_the_others_are_named_with_the_way() {
    const OF_SQLITE: &str = "a bag of SQLite. Convert it with `ros2 bag convert` or \
        `rosbags-convert`, or read it with `joulebus.read_bag` in Python";
    let fleet = Fleet::new();
    let folder = fleet.path("office");
    fs::create_dir(&folder).unwrap();
    let refused = |path: &Path| run(format!("import {} -o {}", text(path), text(&fleet.path("x"))));
    let ended = refused(&folder).exits(1);
    assert!(stderr(&ended).contains("no .mcap file is in this folder"), "{}", stderr(&ended));
    // Whatever the file contains: its recorder may have been killed.
    for (name, bytes) in [("a.db3", &b"SQLite format 3\0"[..]), ("empty.DB3", b"")] {
        let path = fleet.path(name);
        fs::write(&path, bytes).unwrap();
        let ended = refused(&path).exits(1);
        assert_contains(&stderr(&ended), [&format!("{name}: {OF_SQLITE}")]);
        assert!(!fleet.path("x").exists());
    }
    fs::write(folder.join("office_0.db3"), b"SQLite format 3\0").unwrap();
    let ended = refused(&folder).exits(1);
    assert_contains(&stderr(&ended), [&format!("office_0.db3: {OF_SQLITE}")]);
    fs::write(folder.join("office_1.mcap"), crate::doors::bag("").unwrap()).unwrap();
    // A last file that a loss of power left empty.
    fs::write(folder.join("office_2.mcap"), "").unwrap();
    fs::write(folder.join("office_3.mcap.zstd"), "").unwrap();
    let listed = "  relative_file_paths:\n    - office_1.mcap\n    - office_4.mcap\n";
    fs::write(folder.join("metadata.yaml"), listed).unwrap();
    let out = fleet.path("trials");
    let ended = run(format!("import {} -o {}", text(&folder), text(&out))).exits(3);
    let expected = [
        "300 rows of",
        &format!("office_0.db3: {OF_SQLITE}"),
        "office_2.mcap: byte 0: found an empty file",
        "zstd -d office_3.mcap.zstd",
        "office_4.mcap: metadata.yaml lists it",
    ];
    assert_contains(&stdout(&ended), expected);
}

#[test]
fn a_verb_that_went_is_refused_with_what_takes_its_place() {
    for words in ["export run.mcap --to parquet x", "export", "--format json export --help"] {
        let refused = run(words).exits(2);
        assert_contains(&stderr(&refused), ["export went: ", "joulebus.read"]);
    }
}

#[test]
fn a_recorder_reports_at_once_that_the_worker_runs_with_other_files_than_it_attaches() {
    let fleet = Fleet::new();
    let platform = joulebus_config::builtin_platform("gternal").unwrap();
    let model = |text: &str| fs::write(fleet.path("m.safetensors"), text).unwrap();
    let shipped =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors");
    fs::copy(shipped, fleet.path("m.safetensors")).unwrap();
    let own: Vec<String> = (platform.lines())
        .map(|line| match line.starts_with("model = ") {
            true => "model = \"m.safetensors\"".to_owned(),
            false => line.to_owned(),
        })
        .collect();
    fs::write(fleet.path("own.toml"), own.join("\n")).unwrap();
    let config = fs::read_to_string(fleet.config()).unwrap();
    fs::write(fleet.config(), config.replace("builtin:gternal", "own.toml")).unwrap();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 2"));
    let record = |name: &str| {
        let mut command = fleet.joulebus("record --format json --duration 1");
        command.arg("-o").arg(fleet.path(name));
        command
    };
    let ended = record("same.mcap").output().unwrap();
    let same = json(&ended);
    // Messages may be lost on a busy machine.
    let expected = if same["messages_lost"] == 0 { 0 } else { 3 };
    assert_eq!(code(&ended), expected, "{same}");
    assert!(same["differs"].is_null(), "{same}");
    // A deployment, before the worker's restart.
    let config = fs::read_to_string(fleet.config()).unwrap();
    let other = config.replace("[intake]\n", "[intake]\nleave_after_s = 77\n");
    fs::write(fleet.config(), &other).unwrap();
    let mut recorder = Program::start(record("settings.mcap"));
    recorder.wait_for_stderr("cannot be verified");
    assert_contains(&json(&recorder.wait().exits(3))["differs"], ["other settings"]);
    fs::write(fleet.config(), config).unwrap();
    model("");
    let ended = record("model.mcap").output().unwrap().exits(3);
    assert_contains(&json(&ended)["differs"], ["m.safetensors", "is refused"]);
    assert!(json(&ended)["messages"].as_u64().unwrap() > 0, "what there is, is recorded");
    source.end(Signal::TERM).exits(0);
    worker.end(Signal::TERM).exits(0);
}
