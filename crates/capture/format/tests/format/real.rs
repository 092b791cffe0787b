//! Inspection of real recordings.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use joulebus_capture_format::inspect::{Sequence, inspect};
use joulebus_testkit::recordings::shared;

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "mcap"))
        .collect();
    files.sort();
    files
}

#[test]
fn conformance_files_have_no_errors() {
    let Some(folder) = shared("mcap/conformance") else {
        return;
    };
    for variant in fs::read_dir(folder).unwrap() {
        let variant = variant.unwrap().path();
        if !variant.is_dir() {
            continue;
        }
        for file in files(&variant) {
            let found = inspect(File::open(&file).unwrap()).unwrap();
            assert!(found.is_sound() && found.complete, "{}: {:?}", file.display(), found.findings);
        }
    }
}

#[test]
fn real_recordings_are_counted() {
    let Some(folder) = shared("mcap/couguv") else {
        return;
    };
    let found = inspect(File::open(&files(&folder)[0]).unwrap()).unwrap();
    assert!(found.is_sound() && found.complete);
    assert_eq!((found.messages, found.channels.len()), (18_558, 33));
    assert_eq!(found.chunks[0].chunks, 5);
    let battery = found.channels.iter().find(|channel| channel.topic == "/coug2/battery/data");
    let battery = battery.unwrap();
    assert_eq!(battery.messages, 2628);
    // Bursts: the steps between them are gaps relative to the steps within.
    assert!(battery.gaps > 1000 && battery.sequence == Sequence::Unused);
}

#[test]
fn every_rosbag2_corner_case_is_read_to_its_end() {
    let Some(folder) = shared("mcap/rosbag2") else {
        return;
    };
    let files = files(&folder);
    assert_eq!(files.len(), 20);
    for file in files {
        let found = inspect(File::open(&file).unwrap()).unwrap();
        let is_read = found.complete && found.is_sound() && found.messages > 0;
        assert!(is_read, "{}: {:?}", file.display(), found.findings);
    }
}
