//! Names that a crate must not use.

use std::fs;
use std::path::Path;

use super::{crates, names, sources};

/// Code without comments, so that comments may use the names.
fn code(text: &str) -> String {
    let code_of = |line: &str| line.split("//").next().unwrap_or_default().to_owned();
    text.lines().map(|line| code_of(line) + "\n").collect()
}

/// Places below `directory` whose code contains one of `words`, except in `allowed` files.
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
fn the_core_uses_no_clock_file_thread_or_shared_memory() {
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
    for pure in ["settings", "fleet", "energy", "predictor"] {
        assert_eq!(
            places(&crates().join(pure).join("src"), &words, &[]),
            Vec::<String>::new()
        );
    }
    let plan = places(
        &crates().join("plan/src"),
        &words,
        &["plan/src/planner.rs", "plan/src/client.rs"],
    );
    assert_eq!(plan, Vec::<String>::new());
    let mapping = places(&crates().join("bridge/src/mapping"), &words, &[]);
    assert_eq!(mapping, Vec::<String>::new());
}

/// The network between hosts is named in one file, and what two links tell each other needs neither it nor a clock.
#[test]
fn only_one_file_of_the_link_uses_zenoh() {
    for name in names() {
        let found = places(
            &crates().join(name).join("src"),
            &["zenoh::"],
            &["link/src/network.rs"],
        );
        assert_eq!(found, Vec::<String>::new());
    }
    let words = [
        "std::time",
        "std::fs",
        "std::thread",
        "std::net",
        "tracing",
        "joulebus_bus",
        "joulebus_consumer",
    ];
    let protocol = places(&crates().join("link/src/protocol"), &words, &[]);
    assert_eq!(protocol, Vec::<String>::new());
}

#[test]
fn only_the_bus_uses_iceoryx2() {
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
fn only_the_capture_uses_mcap() {
    for name in names().iter().filter(|name| *name != "capture") {
        let found = places(&crates().join(name).join("src"), &["mcap::"], &[]);
        assert_eq!(found, Vec::<String>::new());
    }
}

#[test]
fn only_archives_of_datasets_use_parquet() {
    for name in names() {
        let found = places(
            &crates().join(&name).join("src"),
            &["parquet::"],
            &["schema", "read", "write"]
                .map(|file| format!("dataset/src/archive/{file}.rs"))
                .each_ref()
                .map(String::as_str),
        );
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

/// The wall clock may be set at any time in either direction: it is used only for labels, not to
/// order or measure.
#[test]
fn row_6_only_labels_come_from_the_wall_clock() {
    let labels = [
        "bus/src/os/clock.rs",
        // Identity of the lock's holder: pid and time of locking.
        "bus/src/liveness/worker_lock.rs",
        // `sent_unix_ns` of frames.
        "publisher/src/publisher.rs",
        "predictor-worker/src/outbox.rs",
        "predictor-worker/src/keyframes.rs",
        "cli/src/replay/ports.rs",
        // Age of a file, which only the wall clock gives.
        "bus/src/cleanup/objects.rs",
        "cli/src/doctor/host.rs",
        // Timestamps in recordings of other programs.
        "capture/src/import/join.rs",
        // Time the machine was off, which no other clock gives.
        "predictor-worker/src/checkpointer.rs",
        // Clocks that an operator states are kept together, within what round trips of the monotonic one leave open.
        "link/src/wall_clock.rs",
        // What a page shows beside its values.
        "serve/src/http/reader.rs",
        // Times that other hosts are told.
        "bridge/src/telling.rs",
        // Captures and their names contain their creation time.
        "capture/src/clock.rs",
        "capture/src/attachments.rs",
        "cli/src/demo/capture.rs",
        // Platform files contain the date of their calibration.
        "lab/src/calibrate.rs",
    ];
    for name in names() {
        let words = ["unix_ns()", "SystemTime", "Realtime", "realtime_minus"];
        let found = places(&crates().join(&name).join("src"), &words, &labels);
        assert_eq!(found, Vec::<String>::new(), "{name}");
    }
}
