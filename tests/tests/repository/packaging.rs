//! Every published crate depends on the others in their one exact version: users get the crates of
//! one release.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// Cargo's metadata of the workspace; with `dependencies`, of all crates in its dependency graph.
pub(crate) fn metadata(dependencies: bool) -> Value {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["metadata", "--format-version", "1", "--locked", "--offline"]);
    if dependencies {
        cargo.args(["--filter-platform", "x86_64-unknown-linux-gnu"]);
    } else {
        cargo.arg("--no-deps");
    }
    let output = cargo.current_dir(root).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

pub(crate) fn packages(metadata: &Value) -> impl Iterator<Item = &Value> {
    metadata["packages"].as_array().unwrap().iter()
}

/// Published crates: all without `publish = false`.
fn published(metadata: &Value) -> Vec<&Value> {
    packages(metadata).filter(|package| package["publish"] != serde_json::json!([])).collect()
}

pub(crate) fn name(package: &Value) -> &str {
    package["name"].as_str().unwrap()
}

#[test]
fn workspace_crates_depend_on_each_other_in_one_exact_version() {
    let metadata = metadata(false);
    let published = published(&metadata);
    let version = published[0]["version"].as_str().unwrap();
    for package in &published {
        assert_eq!(package["version"], version, "{}", name(package));
        for dependency in package["dependencies"].as_array().unwrap() {
            if dependency["path"].is_null() {
                continue;
            }
            let is_published = published.iter().any(|other| other["name"] == dependency["name"]);
            // Cargo omits dev-dependencies without a version from a package.
            let is_left_out = dependency["kind"] == "dev" && dependency["req"] == "*";
            assert!(
                (is_published && dependency["req"] == format!("={version}")) || is_left_out,
                "{} needs {} {}",
                name(package),
                dependency["name"],
                dependency["req"]
            );
        }
    }
}

/// What crates.io and docs.rs show of a crate.
#[test]
fn each_published_crate_states_what_registries_show() {
    let metadata = metadata(false);
    for package in published(&metadata) {
        let of = name(package);
        assert_eq!(package["documentation"], format!("https://docs.rs/{of}"));
        for key in ["description", "readme", "repository", "license"] {
            assert!(package[key].as_str().is_some_and(|text| !text.is_empty()), "{of}: {key}");
        }
        for key in ["keywords", "categories"] {
            let count = package[key].as_array().map_or(0, Vec::len);
            assert!((1..=5).contains(&count), "{of}: {count} {key}");
        }
        let targets = &package["metadata"]["docs"]["rs"]["targets"];
        assert_eq!(targets[0], "x86_64-unknown-linux-gnu", "{of}: package.metadata.docs.rs");
    }
}

/// Cargo leaves development dependencies without a version out of a package, so an example cannot
/// use them.
#[test]
fn the_sdk_ships_examples_that_use_published_crates_alone() {
    let metadata = metadata(false);
    let mut with_examples = Vec::new();
    for package in published(&metadata) {
        let targets = package["targets"].as_array().unwrap().iter();
        for target in targets.filter(|target| target["kind"][0] == "example") {
            with_examples.push(name(package));
            let path = target["src_path"].as_str().unwrap();
            let text = std::fs::read_to_string(path).unwrap();
            assert!(!text.contains("joulebus_test"), "{path} uses an unpublished crate");
            let manifest = std::fs::read_to_string(package["manifest_path"].as_str().unwrap());
            let manifest = manifest.unwrap();
            let ships = ["include.workspace = true", "\"/examples\""];
            assert!(
                ships.iter().any(|text| manifest.contains(text)),
                "{path} is not in the package"
            );
        }
    }
    for of in ["publisher", "consumer", "planner", "predictor-worker"] {
        assert!(
            with_examples.contains(&&*format!("joulebus-{of}")),
            "joulebus-{of} has no example"
        );
    }
}
