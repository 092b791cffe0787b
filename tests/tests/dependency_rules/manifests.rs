//! Which crate may depend on which.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

use super::{crates, names};

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
