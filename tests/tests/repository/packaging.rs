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
