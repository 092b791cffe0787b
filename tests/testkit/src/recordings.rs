//! The recordings beside the project, which are not part of it.

use std::path::{Path, PathBuf};

/// The file or folder of this name below `../shared`; `None`, and a line on stdout, if absent.
///
/// # Panics
/// The file is absent, and the variable `CI` is "true": there, no test may be skipped.
pub fn shared(name: &str) -> Option<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .find(|folder| folder.join("Cargo.lock").is_file())
        .expect("tests run in the workspace");
    let path = workspace.join("../shared").join(name);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var("CI").as_deref() != Ok("true"), "{} is missing", path.display());
    println!("skipped: {} is missing", path.display());
    None
}

/// The recorded trials of a platform, sorted by name; `None` as [`shared`].
///
/// # Panics
/// As [`shared`], or the folder cannot be read.
pub fn trials(platform: &str) -> Option<Vec<PathBuf>> {
    let entries = std::fs::read_dir(shared(&format!("data/{platform}"))?).expect("a folder");
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("a file").path()).collect();
    paths.retain(|path| path.to_string_lossy().ends_with(".csv.gz"));
    paths.sort();
    Some(paths)
}
