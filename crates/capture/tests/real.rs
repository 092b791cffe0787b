//! Real recordings, and what is to be said about them.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use joulebus_capture::inspect::{Sequence, StatisticsCheck, inspect};

/// A folder of recordings, or nothing where they are not at hand.
fn folder(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/mcap")
        .join(name);
    if path.is_dir() {
        return Some(path);
    }
    assert!(
        std::env::var_os("CI").is_none(),
        "{} is missing",
        path.display()
    );
    println!("skipped: {} is missing", path.display());
    None
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "mcap")
        })
        .collect();
    files.sort();
    files
}

#[test]
fn nothing_is_wrong_with_any_conformance_file() {
    let Some(folder) = folder("conformance") else {
        return;
    };
    for variant in fs::read_dir(folder).unwrap() {
        let variant = variant.unwrap().path();
        if !variant.is_dir() {
            continue;
        }
        for file in files(&variant) {
            let found = inspect(File::open(&file).unwrap()).unwrap();
            assert!(
                found.is_sound() && found.complete,
                "{}: {:?}",
                file.display(),
                found.findings
            );
        }
    }
}

#[test]
fn p() {
    for f in ["couguv", "rosbag2"] {
        for file in files(&folder(f).unwrap()) {
            let found = inspect(File::open(&file).unwrap()).unwrap();
            println!("=== {}\n{found}", file.display());
            for f in &found.findings {
                println!("{f}");
            }
        }
    }
}
