//! Dependency rules, checked against sources and manifests.

mod circles;
mod imports;
mod manifests;
mod statics;
mod third_party;
mod unsafe_code;
mod words;
mod workarounds;

use std::fs;
use std::path::{Path, PathBuf};

/// All Rust sources below `directory`, with their text.
fn sources(directory: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut open = vec![directory.to_owned()];
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(&directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path, text));
            }
        }
    }
    assert!(!found.is_empty(), "no sources below {}", directory.display());
    found
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn crates() -> PathBuf {
    root().join("crates")
}

/// A package with sources of its own.
struct Member {
    /// The name in ARCHITECTURE.md: the package's name without `joulebus-`, `cli` and `benches`.
    name: String,
    directory: PathBuf,
    manifest: String,
}

/// The packages below `directory`, which may lie in folders.
fn members_below(directory: &Path) -> Vec<Member> {
    let mut found = Vec::new();
    let mut open = vec![directory.to_owned()];
    while let Some(directory) = open.pop() {
        if let Ok(manifest) = fs::read_to_string(directory.join("Cargo.toml")) {
            let (_, after) = manifest.split_once("\nname = \"").unwrap();
            let (package, _) = after.split_once('"').unwrap();
            let name = match package.strip_prefix("joulebus-") {
                None => "cli",
                Some("bench") => "benches",
                Some(name) => name,
            };
            if directory.join("src").is_dir() {
                found.push(Member {
                    name: name.to_owned(),
                    directory: directory.clone(),
                    manifest,
                });
            }
        }
        for entry in fs::read_dir(&directory).unwrap() {
            let path = entry.unwrap().path();
            let is_source = ["src", "tests", "target"].iter().any(|name| path.ends_with(name));
            if path.is_dir() && !is_source {
                open.push(path);
            }
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

fn members() -> Vec<Member> {
    members_below(&crates())
}
