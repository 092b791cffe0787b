//! What is true by absence, read from the sources: each room knows only what it may know.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::collections::{BTreeMap, BTreeSet};
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
    assert!(
        !found.is_empty(),
        "no sources below {}",
        directory.display()
    );
    found
}

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .join("crates")
}

fn names() -> Vec<String> {
    fs::read_dir(crates())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect()
}

/// Code without comments, so that a document may name what the code must not.
fn code(text: &str) -> String {
    let code_of = |line: &str| line.split("//").next().unwrap_or_default().to_owned();
    text.lines().map(|line| code_of(line) + "\n").collect()
}

/// Places below `directory` whose code has one of `words`, except in `allowed` files.
fn places(directory: &Path, words: &[&str], allowed: &[&str]) -> Vec<String> {
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

#[test]
fn unsafe_code_stays_in_its_named_files() {
    let allowed = [
        "predictor/src/kernel/avx2.rs",
        "predictor/src/kernel/avx512.rs",
        "predictor/src/kernel/neon.rs",
        "predictor/src/kernel/forward.rs",
        "predictor/src/kernel/prefetch.rs",
        // A trait that promises to have initialised, and its implementation for one lane.
        "predictor/src/kernel/lanes.rs",
        "predictor/src/kernel/scalar.rs",
    ];
    for name in names().iter().filter(|name| *name != "bus") {
        let found = places(
            &crates().join(name).join("src"),
            &["unsafe {", "unsafe impl", "unsafe fn", "unsafe trait"],
            &allowed,
        );
        assert_eq!(found, Vec::<String>::new());
        let root = fs::read_to_string(crates().join(name).join("src/lib.rs")).unwrap();
        let level = if ["predictor"].contains(&name.as_str()) {
            "deny"
        } else {
            "forbid"
        };
        let lint = format!("#![{level}(unsafe_code)]");
        // The workspace denies it already; `predictor` allows it in the files above.
        assert!(
            level == "deny" || root.contains(&lint),
            "{name} lacks {lint}"
        );
    }
}

#[test]
fn every_unsafe_block_says_why_it_is_sound() {
    for (path, text) in sources(&crates()) {
        let lines: Vec<&str> = text.lines().collect();
        for (number, line) in lines.iter().enumerate() {
            let opens = line.contains("unsafe {") || line.contains("unsafe impl");
            if !opens || line.trim_start().starts_with("//") {
                continue;
            }
            let above = &lines[number.saturating_sub(8)..number];
            let said = above.iter().any(|line| line.contains("SAFETY:"));
            assert!(
                said,
                "{}:{} has no SAFETY: above it",
                path.display(),
                number + 1
            );
        }
    }
}

#[test]
fn dependencies_point_one_way() {
    let order = [
        "wire",
        "settings",
        "predictor",
        "fleet",
        "bus",
        "config",
        "publisher",
        "predictor-worker",
        "consumer",
        "capture",
        "statistics",
        "dataset",
        "sim",
        "train",
        "eval",
        "model-files",
        "program",
        "report",
        "serve",
    ];
    let manifest = |name: &str| fs::read_to_string(crates().join(name).join("Cargo.toml")).unwrap();
    for (place, name) in order.iter().enumerate() {
        let manifest = manifest(name);
        let dependencies = manifest.split("[dev-dependencies]").next().unwrap();
        for later in order[place + 1..].iter().chain(&["bench"]) {
            let dependency = format!("joulebus-{later}.");
            assert!(
                !dependencies.contains(&dependency),
                "{name} depends on {later}"
            );
        }
        assert!(
            !dependencies.contains("\njoulebus."),
            "{name} depends on the program"
        );
    }
    for glue in ["publisher", "predictor-worker", "consumer"] {
        for other in ["publisher", "predictor-worker", "consumer"] {
            let dependency = format!("joulebus-{other}.workspace");
            let manifest = manifest(glue);
            let dependencies = manifest.split("[dev-dependencies]").next().unwrap();
            assert!(
                !dependencies.contains(&dependency),
                "{glue} depends on {other}"
            );
        }
    }
}

#[test]
fn what_all_programs_share_is_light() {
    let graph = direct_dependencies();
    let ours = graph["joulebus-program"]
        .iter()
        .filter(|name| name.starts_with("joulebus"));
    for name in ours {
        let light =
            ["bus", "config", "predictor", "settings"].map(|name| format!("joulebus-{name}"));
        assert!(light.contains(name), "program depends on {name}");
    }
}

/// The workspace's packages and their direct dependencies, other than those of their tests, by the
/// names of their tables.
fn direct_dependencies() -> BTreeMap<String, Vec<String>> {
    let manifests = names().into_iter().map(|name| {
        let manifest = fs::read_to_string(crates().join(&name).join("Cargo.toml")).unwrap();
        let (_, after) = manifest.split_once("\n[dependencies]\n").unwrap();
        let table = after.split("\n[").next().unwrap();
        let dependencies = table.lines().filter_map(|line| {
            let end = line.find(['.', ' ', '='])?;
            Some(line[..end].to_owned()).filter(|name| !name.starts_with('#'))
        });
        (format!("joulebus-{name}"), dependencies.collect())
    });
    manifests.collect()
}

/// The packages of `Cargo.lock` and what each depends on.
fn locked_dependencies() -> BTreeMap<String, Vec<String>> {
    let lock = fs::read_to_string(crates().parent().unwrap().join("Cargo.lock")).unwrap();
    let mut locked: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in lock.split("[[package]]").skip(1) {
        let quoted: Vec<&str> = package.split('"').skip(1).step_by(2).collect();
        let list = package.split_once("dependencies = [");
        let list = list.map_or("", |(_, list)| list);
        let names = list.split('"').skip(1).step_by(2);
        // Of two versions of a package the lock names each with its version.
        let names = names.filter_map(|name| Some(name.split(' ').next()?.to_owned()));
        locked
            .entry(quoted[0].to_owned())
            .or_default()
            .extend(names);
    }
    locked
}

#[test]
fn the_sdk_compiles_no_kernel_no_tick_and_no_thread_pool() {
    let mut graph = locked_dependencies();
    // The lock does not tell the dependencies of a package's tests from its own.
    graph.extend(direct_dependencies());
    for sdk in ["joulebus-publisher", "joulebus-consumer"] {
        let mut reached = BTreeSet::new();
        let mut open = vec![sdk.to_owned()];
        while let Some(name) = open.pop() {
            if reached.insert(name.clone()) {
                open.extend(graph[&name].iter().cloned());
            }
        }
        assert!(reached.contains("iceoryx2"), "{reached:?}");
        for heavy in ["joulebus-predictor", "joulebus-fleet", "rayon"] {
            assert!(!reached.contains(heavy), "{sdk} reaches {heavy}");
        }
    }
}

#[test]
fn measurements_stand_below_nothing() {
    let root = crates().parent().unwrap().to_owned();
    let dependencies = |manifest: PathBuf| {
        let manifest = fs::read_to_string(manifest).unwrap();
        let normal = manifest.split("[dev-dependencies]").next().unwrap();
        normal.to_owned()
    };
    for name in names() {
        let dependencies = dependencies(crates().join(&name).join("Cargo.toml"));
        assert!(
            !dependencies.contains("joulebus-bench"),
            "{name} depends on the measurements"
        );
    }
    let benches = dependencies(root.join("benches/Cargo.toml"));
    for above in [
        "\njoulebus.workspace",
        "joulebus-dataset",
        "joulebus-sim",
        "joulebus-train",
        "joulebus-eval",
        "joulebus-model-files",
        "joulebus-report",
    ] {
        assert!(!benches.contains(above), "benches depends on {above}");
    }
}

#[test]
fn the_crates_are_the_ones_that_the_architecture_describes() {
    let page = crates().parent().unwrap().join("ARCHITECTURE.md");
    let page = fs::read_to_string(page).unwrap();
    for name in names() {
        assert!(
            page.contains(&format!("| `{name}` |")),
            "ARCHITECTURE.md says nothing of {name}"
        );
    }
}
