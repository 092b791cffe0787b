//! Pipes, devices, directories and sockets in place of every input file are refused at once with a
//! reason; in place of output files they are left unchanged.

use std::fs;
use std::os::unix::fs::{FileTypeExt as _, symlink};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rustix::fs::{CWD, FileType, Mode, mknodat};

use crate::captures::capture;
use crate::fleet::{Fleet, Program, at, code, joulebus, stderr};

/// Every argument that is an input file; X is the file.
const READERS: [&str; 33] = [
    "run --config X",
    "record -o OUT --config X",
    "publish sim --config X",
    "watch --once --config X",
    "doctor --config X",
    "config check X",
    "config show X",
    "info X",
    "doctor X",
    "recover X -o OUT",
    "import X -o OUT",
    "import CAPTURE -o OUT --mapping X",
    "replay X",
    "replay --verify X",
    "replay --no-wait CAPTURE X",
    "replay --no-wait CAPTURE --config X",
    "replay CAPTURE --model X",
    "data check X",
    "data info X",
    "data convert X --to npy --out OUT",
    "publish trial X@0 --no-wait --config FLEET",
    "eval --model MODEL X",
    "eval --model X TRIAL",
    "analyze X",
    "analyze TRIAL --model X",
    "train trials X --out OUT",
    "train trials TRIAL --recipe X --out OUT",
    "model info X",
    "model import X --data TRIAL --out OUT",
    "model export X --out OUT.onnx",
    "model compare X MODEL TRIAL",
    "model compare MODEL X TRIAL",
    "model compare MODEL MODEL X",
];
const MODEL: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors");

fn fifo(path: &Path) {
    mknodat(CWD, path, FileType::Fifo, Mode::from_raw_mode(0o600), 0).unwrap();
}

/// Non-regular files and their kinds. The socket lives as long as the returned value.
fn special_files(fleet: &Fleet) -> (Vec<(PathBuf, &'static str)>, UnixListener) {
    let at = |name: &str| fleet.path(name);
    fs::create_dir(at("directory")).unwrap();
    fifo(&at("pipe"));
    symlink(at("pipe"), at("link to a pipe")).unwrap();
    let socket = UnixListener::bind(at("socket")).unwrap();
    let files = vec![
        (at("pipe"), "a named pipe"),
        (at("link to a pipe"), "a named pipe"),
        (at("socket"), "a socket"),
        (at("directory"), "director"),
        (PathBuf::from("/dev/zero"), "a device"),
    ];
    (files, socket)
}

/// Runs a verb, whose words in capitals are files: the one that is tried, a capture and a trial.
fn called(fleet: &Fleet, verb: &str, [tried, capture, trial]: [&Path; 3]) -> Output {
    let word = |word: &str| match word {
        "X" => tried.to_owned(),
        "X@0" => at(tried, "0"),
        "CAPTURE" => capture.to_owned(),
        "TRIAL" => trial.to_owned(),
        "FLEET" => fleet.config(),
        "MODEL" => PathBuf::from(MODEL),
        "OUT" => fleet.path("out"),
        "OUT.onnx" => fleet.path("out.onnx"),
        word => PathBuf::from(word),
    };
    let mut command = joulebus(verb.split_whitespace().map(word));
    // Waiting for a pipe would never end.
    command.current_dir(fleet.path(""));
    Program::start(command).wait()
}

#[test]
fn files_that_are_not_regular_are_refused_as_input_of_every_verb() {
    let fleet = Fleet::new();
    let (specials, _socket) = special_files(&fleet);
    let (whole, _) = capture(&fleet, 100);
    let trial = fleet.recording("trial.csv", 100);
    for verb in READERS {
        for (special, kind) in &specials {
            let ended = called(&fleet, verb, [special, &whole, &trial]);
            let (printed, shown) = (stderr(&ended), special.display());
            // A replay of several files plays the readable ones, and reports the others at its end.
            let codes = if verb.contains("CAPTURE X") { 3..=3 } else { 1..=2 };
            assert!(codes.contains(&code(&ended)), "{verb}, {shown}: {ended:?}");
            assert!(!printed.contains("panicked"), "{verb}, {shown}: {printed}");
            let output_text = String::from_utf8_lossy(&ended.stdout).into_owned() + &printed;
            assert!(output_text.contains(kind), "{verb}, {shown}: {output_text}");
            assert!(!fleet.path("out").exists(), "{verb}, {shown}");
        }
    }
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn every_verb_that_reads_recordings_or_models_names_the_kind_of_another_file() {
    let fleet = Fleet::new();
    let trial = fleet.recording("trial.csv", 100);
    let pointer = fleet.path("pointer.mcap");
    let text = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 4000000\n";
    fs::write(&pointer, text).unwrap();
    let others = ["--config X", "config", "CAPTURE", "--recipe X"];
    let doors = READERS.iter().filter(|verb| others.iter().all(|other| !verb.contains(other)));
    let mut asked = 0;
    for verb in doors {
        let ended = called(&fleet, verb, [&pointer, Path::new("CAPTURE"), &trial]);
        let output_text = String::from_utf8_lossy(&ended.stdout).into_owned() + &stderr(&ended);
        assert!((1..=3).contains(&code(&ended)), "{verb}: {output_text}");
        assert!(
            output_text.contains("a pointer of Git LFS") && output_text.contains("git lfs pull"),
            "{verb}: {output_text}"
        );
        asked += 1;
    }
    assert_eq!(asked, 20);
}

#[test]
fn files_named_in_a_config_are_checked_before_anything_is_created() {
    let fleet = Fleet::new();
    let (specials, _socket) = special_files(&fleet);
    let text = fs::read_to_string(fleet.config()).unwrap();
    let config = fleet.path("special.toml");
    for (special, kind) in &specials {
        let shown = special.display();
        for named in [
            text.replace("file = \"builtin:gternal\"", &format!("file = \"{shown}\"")),
            text.replace(
                "file = \"builtin:gternal\"",
                &format!("file = \"builtin:gternal\"\nmodel = \"{shown}\""),
            ),
        ] {
            fs::write(&config, named).unwrap();
            for verb in ["run --config", "config check", "record -o out --config"] {
                let mut command = joulebus(verb.split_whitespace());
                command.arg(&config).current_dir(fleet.path(""));
                let ended = Program::start(command).wait();
                assert_eq!(code(&ended), 2, "{verb}, {shown}: {ended:?}");
                assert!(stderr(&ended).contains(kind), "{verb}: {}", stderr(&ended));
            }
        }
        fs::write(&config, text.replace("checkpoint = \"\"", &format!("checkpoint = \"{shown}\"")))
            .unwrap();
        let run = joulebus(["run".as_ref(), "--config".as_ref(), config.as_os_str()]);
        let ended = Program::start(run).wait();
        assert_eq!(code(&ended), 1, "ledger {shown}: {ended:?}");
        assert!(stderr(&ended).contains(kind), "{}", stderr(&ended));
    }
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_pipe_is_not_replaced_by_a_file_that_is_written() {
    let fleet = Fleet::new();
    let pipe = fleet.path("pipe");
    fifo(&pipe);
    for verb in [format!("model export {MODEL} --to npz --out"), "record -o".to_owned()] {
        let mut command: Command = joulebus(verb.split_whitespace());
        command.arg(&pipe);
        if verb.starts_with("record") {
            command.arg("--config").arg(fleet.config());
        }
        let ended = Program::start(command).wait();
        assert_eq!(code(&ended), 1, "{verb}: {ended:?}");
        let kind = fs::symlink_metadata(&pipe).unwrap().file_type();
        assert!(kind.is_fifo(), "{verb}");
    }
    assert!(fleet.stale_files().is_empty());
}
