//! What a crate must not name.

use std::fs;
use std::path::Path;

use super::{crates, names, sources};

/// Code without comments, so that a document may name what the code must not.
fn code(text: &str) -> String {
    let code_of = |line: &str| line.split("//").next().unwrap_or_default().to_owned();
    text.lines().map(|line| code_of(line) + "\n").collect()
}

/// Places below `directory` whose code has one of `words`, except in `allowed` files.
pub(crate) fn places(directory: &Path, words: &[&str], allowed: &[&str]) -> Vec<String> {
    let mut places = Vec::new();
    for (path, text) in sources(directory) {
        if allowed.iter().any(|allowed| path.ends_with(allowed)) {
            continue;
        }
        let text = code(&text);
        let found = words.iter().filter(|word| text.contains(**word));
        places.extend(found.map(|word| format!("{word} in {}", path.display())));
    }
    places
}

#[test]
fn the_core_knows_no_clock_file_thread_or_shared_memory() {
    let words = [
        "std::time",
        "Instant::",
        "SystemTime",
        "std::fs",
        "std::net",
        "std::thread",
        "std::process",
        "std::env",
        "iceoryx2",
        "rustix",
        "tracing",
        "joulebus_bus",
    ];
    for pure in ["settings", "fleet", "predictor"] {
        assert_eq!(
            places(&crates().join(pure).join("src"), &words, &[]),
            Vec::<String>::new()
        );
    }
}

#[test]
fn only_the_bus_names_iceoryx2() {
    for name in names().iter().filter(|name| *name != "bus") {
        let found = places(
            &crates().join(name).join("src"),
            &["iceoryx2::", "iceoryx2_"],
            &["wire/src/layout.rs"],
        );
        assert_eq!(found, Vec::<String>::new());
    }
}

#[test]
fn only_the_capture_names_mcap() {
    for name in names().iter().filter(|name| *name != "capture") {
        let found = places(&crates().join(name).join("src"), &["mcap::"], &[]);
        assert_eq!(found, Vec::<String>::new());
    }
}

#[test]
fn only_model_files_reads_pickles() {
    let words = ["pickle", "STACK_GLOBAL", "_rebuild_tensor"];
    for name in names().iter().filter(|name| *name != "model-files") {
        let found = places(&crates().join(name).join("src"), &words, &[]);
        assert_eq!(found, Vec::<String>::new());
    }
    let worker = fs::read_to_string(crates().join("predictor-worker/Cargo.toml")).unwrap();
    let dependencies = worker.split("[dev-dependencies]").next().unwrap();
    for reader in ["joulebus-model-files", "zip", "pickle"] {
        assert!(
            !dependencies.contains(reader),
            "the worker depends on {reader}"
        );
    }
}
