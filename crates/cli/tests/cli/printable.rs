//! Names with escape sequences, in files and of files, are escaped in all output.

use std::fs;
use std::path::Path;
use std::process::Output;

use joulebus_capture_format::{Attachments, CaptureSettings, Message, Times, Writer};
use joulebus_wire::{Sample, SampleHeader, Samples};

use crate::fleet::{Fleet, output};

/// Clears the screen, sets a title, and contains the single character that some terminals interpret
/// as ESC [.
const EVIL: &str = "x\u{1b}[2J\u{1b}]0;y\u{7}\u{9b}31m\r\u{202e}z";

/// Control characters that a terminal would execute.
fn is_obeyed(letter: char) -> bool {
    letter.is_control() && letter != '\n' && letter != '\t' || letter == '\u{202e}'
}

fn assert_is_printable(arguments: &[&str], ended: &Output) {
    for bytes in [&ended.stdout, &ended.stderr] {
        let printed = std::str::from_utf8(bytes).unwrap();
        assert!(!printed.contains(is_obeyed), "{arguments:?}: {printed:?}");
    }
}

/// A capture in which fleet, topics and file have that name.
fn capture(folder: &Path) -> String {
    let path = folder.join(format!("{EVIL}.mcap"));
    let mut attachments = Attachments::default();
    attachments.describe(EVIL, EVIL.to_owned());
    attachments.add(format!("{EVIL}/config.toml"), EVIL, b"name =".to_vec());
    let mut writer =
        Writer::new(fs::File::create_new(&path).unwrap(), CaptureSettings::default(), &attachments)
            .unwrap();
    let message = Message::of::<Samples>(SampleHeader::default(), vec![Sample::new(0, 0, 0)]);
    writer.write(EVIL, Times::default(), &message).unwrap();
    writer.finish().unwrap();
    path.display().to_string()
}

#[test]
fn names_in_files_and_of_files_are_escaped() {
    let fleet = Fleet::new();
    let file = capture(&fleet.path(""));
    let (csv, config) = (fleet.path(&format!("{EVIL}.csv")), fleet.path(&format!("{EVIL}.toml")));
    let text = format!("timestamp_s,power_mW,robot_id,\"{EVIL}\"\n0,1,{EVIL},1\n1,2,{EVIL},1\n");
    fs::write(&csv, text).unwrap();
    fs::write(&config, format!("[fleet]\n\"{EVIL}\" = \"{EVIL}\"\nname = '{EVIL}'\n")).unwrap();
    let (csv, config) = (csv.display().to_string(), config.display().to_string());
    let result = fleet.path(&format!("{EVIL}.out")).display().to_string();
    let calls: [&[&str]; 15] = [
        &["info", &file],
        &["info", &file, "--format", "json"],
        &["doctor", &file],
        &["recover", &file, "-o", &result],
        &["recover", &file, "-o", &file],
        &["replay", &file],
        &["replay", "--verify", &file],
        &["import", &file, "-o", &result],
        &["data", "info", &csv],
        &["data", "check", &csv],
        &["data", "info", &csv, "--format", "json"],
        &["publish", "trial", &csv, "--rate", EVIL],
        &["config", "check", &config],
        &["run", "--config", &config],
        &[EVIL, EVIL],
    ];
    for arguments in calls {
        assert_is_printable(arguments, &output(arguments));
    }
    let (gone, json) = (format!("/{EVIL}"), ["--format", "json"]);
    for verb in ["info", "doctor", "replay", "run --config", "model info", "data info"] {
        let mut arguments: Vec<&str> = verb.split_whitespace().chain([gone.as_str()]).collect();
        assert_is_printable(&arguments, &output(&arguments));
        arguments.extend(json);
        assert_is_printable(&arguments, &output(&arguments));
    }
    assert!(fleet.stale_files().is_empty());
}
