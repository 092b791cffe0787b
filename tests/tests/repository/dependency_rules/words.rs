//! Names that a crate must not use.

use std::path::{Path, PathBuf};

use super::{Member, members, sources};

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

/// The sources of a crate.
fn src(name: &str) -> PathBuf {
    let members = members();
    let member = members.iter().find(|member| member.name == name);
    member.unwrap().directory.join("src")
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
    let pure = ["settings", "fleet", "energy", "plan", "predictor", "plausibility"];
    for name in pure {
        assert_eq!(places(&src(name), &words, &[]), Vec::<String>::new());
    }
    let mapping = places(&src("bridge").join("mapping"), &words, &[]);
    assert_eq!(mapping, Vec::<String>::new());
}

/// Two files name the network between hosts, one that of ROS 2. The protocols need neither it nor a
/// clock.
#[test]
fn only_four_files_of_the_link_use_zenoh() {
    for member in members() {
        // The last one names targets of its log.
        let files = ["network.rs", "session.rs", "rmw.rs", "tls_causes.rs"]
            .map(|file| format!("link/src/{file}"));
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        let found = places(&member.directory.join("src"), &["zenoh::"], &files);
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
    let protocol = places(&src("link").join("protocol"), &words, &[]);
    assert_eq!(protocol, Vec::<String>::new());
}

#[test]
fn only_the_bus_uses_iceoryx2_only_the_format_of_captures_mcap_and_no_program_reads_pickles() {
    let rules: [(&str, &[&str], &[&str]); 3] = [
        ("bus", &["iceoryx2::", "iceoryx2_"], &["wire/src/layout.rs"]),
        ("capture-format", &["mcap::"], &[]),
        // The file names what nobody reads.
        ("", &["pickle", "STACK_GLOBAL", "_rebuild_tensor"], &["files/src/foreign.rs"]),
    ];
    for (user, words, files) in rules {
        for member in members().iter().filter(|member| member.name != user) {
            let found = places(&member.directory.join("src"), words, files);
            assert_eq!(found, Vec::<String>::new());
        }
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
        "capture/recorder/src/replay/mod.rs",
        // Age of a file, which only the wall clock gives.
        "bus/src/cleanup/objects.rs",
        // Its test gives a file another age.
        "bus/src/description.rs",
        "cli/src/doctor/host.rs",
        // Timestamps in recordings of other programs.
        "capture/format/src/import/join.rs",
        // Time the machine was off, which no other clock gives.
        "predictor-worker/src/checkpointer.rs",
        // From when to when certificates are valid.
        "link/src/certificates.rs",
        // Times of lines of the log.
        "program/src/output.rs",
        // Times at which messages were sent, for their readers.
        "link/src/rmw.rs",
        // Times that a page shows beside its values.
        "serve/src/http/reader.rs",
        // Times of requests, which a signature contains.
        "serve/src/webhook/mod.rs",
        // When a person acknowledged an alarm.
        "plan-server/src/acknowledgements.rs",
        // When a message came, beside the time that it states.
        "bridge/src/mqtt/mod.rs",
        // Times that other hosts receive.
        "bridge/src/outbound.rs",
        // Times in messages, which are compared with those of a simulation.
        "bridge/src/mapping/ros/incoming.rs",
        // Captures and their names contain their creation time.
        "capture/recorder/src/attachments.rs",
        "cli/src/demo/capture.rs",
    ];
    for Member { name, directory, .. } in members() {
        let words = ["unix_ns()", "SystemTime", "ClockId::Realtime"];
        let found = places(&directory.join("src"), &words, &labels);
        assert_eq!(found, Vec::<String>::new(), "{name}");
    }
}
