//! Allowed dependencies between crates.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

use super::{crates, names};

/// The crates in the diagram of ARCHITECTURE.md, line by line from the top.
fn drawing() -> Vec<Vec<String>> {
    let page = fs::read_to_string(crates().parent().unwrap().join("ARCHITECTURE.md")).unwrap();
    let (_, after) = page.split_once("## Crate layout\n\n```\n").unwrap();
    let known = names();
    let crates_of = |line: &str| -> Vec<String> {
        let words = line.split_whitespace().map(str::to_owned);
        words
            .filter(|word| word == "benches" || known.contains(word))
            .collect()
    };
    let (drawing, _) = after.split_once("\n```").unwrap();
    drawing.lines().map(crates_of).collect()
}

#[test]
fn a_crate_depends_only_on_lower_lines_of_the_diagram() {
    let drawing = drawing();
    let line = |name: &str| {
        let found = drawing
            .iter()
            .position(|line| line.iter().any(|other| other == name));
        found.unwrap_or_else(|| panic!("the diagram in ARCHITECTURE.md lacks {name}"))
    };
    line("benches");
    for (package, dependencies) in direct_dependencies() {
        let name = package.strip_prefix("joulebus-").unwrap();
        let above = line(name);
        for dependency in dependencies {
            assert!(dependency != "joulebus", "{name} depends on the program");
            if let Some(below) = dependency.strip_prefix("joulebus-") {
                assert!(line(below) > above, "{name} depends on {below}");
            }
        }
    }
}

#[test]
fn the_program_crate_has_few_dependencies() {
    let graph = direct_dependencies();
    let ours = graph["joulebus-program"]
        .iter()
        .filter(|name| name.starts_with("joulebus"));
    for name in ours {
        let light = ["bus", "config", "files", "predictor", "settings"]
            .map(|name| format!("joulebus-{name}"));
        assert!(light.contains(name), "program depends on {name}");
    }
}

/// Workspace packages and their direct dependencies without dev-dependencies, by the names of their
/// tables.
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

/// The packages of `Cargo.lock` and their dependencies.
fn locked_dependencies() -> BTreeMap<String, Vec<String>> {
    let lock = fs::read_to_string(crates().parent().unwrap().join("Cargo.lock")).unwrap();
    let mut locked: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in lock.split("[[package]]").skip(1) {
        let quoted: Vec<&str> = package.split('"').skip(1).step_by(2).collect();
        let list = package.split_once("dependencies = [");
        let list = list.map_or("", |(_, list)| list);
        let names = list.split('"').skip(1).step_by(2);
        // If the lock file has two versions of a package, the name is followed by the version.
        let names = names.filter_map(|name| Some(name.split(' ').next()?.to_owned()));
        locked
            .entry(quoted[0].to_owned())
            .or_default()
            .extend(names);
    }
    locked
}

/// What a package depends on, directly or not, itself included.
fn reached(graph: &BTreeMap<String, Vec<String>>, package: &str) -> BTreeSet<String> {
    let mut reached = BTreeSet::new();
    let mut open = vec![package.to_owned()];
    while let Some(name) = open.pop() {
        if reached.insert(name.clone()) {
            open.extend(graph[&name].iter().cloned());
        }
    }
    reached
}

#[test]
fn the_sdk_depends_on_no_kernel_no_tick_and_no_thread_pool() {
    let mut graph = locked_dependencies();
    // The lock file does not distinguish dev-dependencies, so the manifests replace it for the
    // workspace.
    graph.extend(direct_dependencies());
    for sdk in ["joulebus-publisher", "joulebus-consumer"] {
        let reached = reached(&graph, sdk);
        assert!(reached.contains("iceoryx2"), "{reached:?}");
        for heavy in ["joulebus-predictor", "joulebus-fleet", "rayon"] {
            assert!(!reached.contains(heavy), "{sdk} reaches {heavy}");
        }
    }
}

#[test]
fn planners_that_compute_reach_no_tick_and_no_thread_pool() {
    let mut graph = locked_dependencies();
    graph.extend(direct_dependencies());
    let reached = reached(&graph, "joulebus-plan");
    assert!(reached.contains("joulebus-energy"), "{reached:?}");
    for heavy in ["joulebus-fleet", "joulebus-predictor-worker", "rayon"] {
        assert!(!reached.contains(heavy), "plan reaches {heavy}");
    }
}

#[test]
fn nothing_depends_on_the_benchmarks() {
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
            "{name} depends on the benchmarks"
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
fn the_architecture_describes_all_crates() {
    let page = crates().parent().unwrap().join("ARCHITECTURE.md");
    let page = fs::read_to_string(page).unwrap();
    for name in names() {
        assert!(
            page.contains(&format!("| `{name}` |")),
            "ARCHITECTURE.md does not mention {name}"
        );
    }
}
