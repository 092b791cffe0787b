//! State of a whole process in the libraries that Python and C load: a host program may fork at any
//! time, and a child finds each lock taken for ever that another thread held.

use std::collections::BTreeSet;

use super::manifests::{graph, reached};
use super::{members, sources};

/// Each static of the libraries, and why a child made by `fork` can use it.
const LISTED: &[(&str, &str)] = &[
    ("bus/src/marker.rs IN_PROGRESS", "a fork section"),
    ("bus/src/os/files.rs DRAFTS", "an atomic"),
    ("bus/src/os/fork.rs FORKS", "an atomic, which a child sets to 0"),
    ("bus/src/os/fork.rs INSIDE", "an atomic, which a child sets to its own"),
    ("bus/src/os/fork.rs REGISTERED", "an atomic, with the process that it is of"),
    ("bus/src/os/process_id.rs KNOWN", "a fork section"),
    ("c/src/abi/errors.rs ALARMS", "constant"),
    ("c/src/abi/errors.rs INVALID_REASONS", "constant"),
    ("c/src/abi/predictor.rs OPEN", "a fork section"),
    ("c/src/handles.rs THREADS", "an atomic"),
    ("predictor/src/gelu.rs ERF", "constant"),
    ("predictor/src/gelu.rs TANH", "constant"),
    ("program/src/logging.rs TAP", "set by programs before they log, and by no library"),
    ("program/src/output.rs CUT", "an atomic"),
    ("program/src/output.rs MISSED", "an atomic"),
    ("program/src/output.rs TO_LOG", "an atomic"),
    ("program/src/stop.rs ASKED", "set by programs before they start threads, and by no library"),
    ("python/src/dtype.rs FORECAST", "a fork section"),
    ("wire/src/alarm_card.rs OF_ROBOTS", "constant"),
];

/// Parts of types that lock.
const LOCKS: &[&str] = &["Mutex", "RwLock", "Once", "Lazy", "Condvar", "Barrier"];

/// Name and type of each static in `text`, but for those of a thread and of unit tests.
fn statics(text: &str) -> Vec<(&str, &str)> {
    let mut found = Vec::new();
    let mut end_of_threads = None;
    for line in text.split("\n#[cfg(test)]\nmod ").next().unwrap().lines() {
        let code = line.trim_start();
        let indent = line.len() - code.len();
        if code.starts_with("thread_local!") {
            end_of_threads = Some(indent);
        }
        let item = match code.split_once(' ') {
            Some((visibility, item)) if visibility.starts_with("pub") => item,
            _ => code,
        };
        if let Some(item) = item.strip_prefix("static ").filter(|_| end_of_threads.is_none()) {
            let item = item.trim_start_matches("mut ");
            let (name, of) = item.split_once(':').unwrap_or((item, ""));
            found.push((name, of.split('=').next().unwrap()));
        }
        if end_of_threads == Some(indent) && code.starts_with('}') {
            end_of_threads = None;
        }
    }
    found
}

#[test]
fn state_of_the_whole_process_in_what_python_and_c_load_is_listed_with_what_a_fork_does_to_it() {
    let graph = graph();
    let loaded: BTreeSet<String> = ["c", "python"]
        .into_iter()
        .flat_map(|library| reached(&graph, library).into_iter().chain([library.to_owned()]))
        .collect();
    let (mut found, mut outside) = (Vec::new(), Vec::new());
    for member in members().iter().filter(|member| loaded.contains(&member.name)) {
        let src = member.directory.join("src");
        for (path, text) in sources(&src) {
            let file = path.strip_prefix(&src).unwrap().display();
            for (name, of) in statics(&text) {
                let place = format!("{}/src/{file} {name}", member.name);
                let locks = LOCKS.iter().any(|lock| of.contains(lock));
                if locks && !text.contains("ForkSection::enter()") {
                    outside.push(place.clone());
                }
                found.push(place);
            }
        }
    }
    found.sort();
    let listed: Vec<&str> = LISTED.iter().map(|(place, _)| *place).collect();
    assert_eq!(found, listed, "list it with what a child made by `fork` finds");
    let of_programs = ["program/src/logging.rs TAP", "program/src/stop.rs ASKED"];
    assert_eq!(outside, of_programs, "put it behind a `ForkSection`");
}

#[test]
fn statics_are_found_and_those_of_threads_and_unit_tests_are_not_taken_for_one() {
    let text = "static ONE: Mutex<()> = Mutex::new(());\n\
        pub(crate) static TWO: [u8; 2] = [1, 2];\n\
        fn name() -> &'static str {\n    // A static one.\n    static mut THREE: OnceLock<u8> = OnceLock::new();\n}\n\
        thread_local! {\n    static FOUR: Cell<u8> = const { Cell::new(0) };\n}\n\
        fn of_thread() {\n    thread_local! {\n        static FIVE: u8 = const {\n            5\n        \
        };\n    }\n    static SIX: LazyLock<u8> = LazyLock::new(|| 6);\n}\n\
        #[cfg(test)]\nmod tests {\n    static SEVEN: Mutex<()> = Mutex::new(());\n}\n";
    let found: Vec<&str> = statics(text).iter().map(|(name, _)| *name).collect();
    assert_eq!(found, ["ONE", "TWO", "THREE", "SIX"]);
}
