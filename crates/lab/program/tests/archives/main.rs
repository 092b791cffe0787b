//! Archives: what an export writes, what other programs read, and that every verb reads them as the
//! original recordings.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod hostile;
mod memory;
mod peers;
mod recordings;
mod same_reports;
mod writing;

use std::path::{Path, PathBuf};

use joulebus_testkit::{Ended, joulebus_beside, run};

/// The program.
const LAB: &str = env!("CARGO_BIN_EXE_joulebus-lab");

/// Exports recordings into a folder.
fn export(paths: &[&Path], folder: &Path) -> Ended {
    export_as(&[], paths, folder)
}

/// Exports recordings with and without fleets and days into one folder.
fn export_mixed(paths: &[&Path], folder: &Path) -> Ended {
    export_as(&["--mixed"], paths, folder)
}

fn export_as(options: &[&str], paths: &[&Path], folder: &Path) -> Ended {
    let words = [&["export", "--format", "json"], options].concat();
    let words = words.iter().map(PathBuf::from);
    let paths = paths.iter().map(PathBuf::from);
    let to = ["--to", "parquet"].map(PathBuf::from);
    let words = words.chain(paths).chain(to);
    run(LAB, words.chain([folder.to_owned()]))
}

/// Runs `joulebus` with these words and paths.
fn joulebus(words: &str, paths: &[&Path]) -> Ended {
    let program = joulebus_beside(LAB).display().to_string();
    let words = words.split_whitespace().map(PathBuf::from);
    run(&program, words.chain(paths.iter().map(PathBuf::from)))
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => found.push(path),
        }
    }
    found.sort();
    found
}

/// The Parquet files below a folder.
fn parquet(folder: &Path) -> Vec<PathBuf> {
    let all = files(folder).into_iter();
    all.filter(|path| path.extension().is_some_and(|ending| ending == "parquet")).collect()
}
