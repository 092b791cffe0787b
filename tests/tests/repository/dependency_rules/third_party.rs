//! Number of third-party crates that each program and each library of the SDK, in any language,
//! compiles.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use serde_json::Value;

use super::crates;

/// Libraries that a controller, a planner, Python or an evaluation of one's own links.
const SDK: [&str; 7] = [
    "joulebus-c",
    "joulebus-consumer",
    "joulebus-eval",
    "joulebus-plan",
    "joulebus-planner",
    "joulebus-publisher",
    "joulebus-python",
];

/// Cargo's output for these arguments, in the root of the workspace.
fn cargo(arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO"));
    let command = command.args(arguments).arg("--locked");
    let output = command.current_dir(crates().parent().unwrap()).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {printed}");
    String::from_utf8(output.stdout).unwrap()
}

/// The published packages that have a program.
fn programs() -> Vec<String> {
    let metadata = cargo(&["metadata", "--format-version=1", "--no-deps"]);
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let has_program = |package: &&Value| {
        let targets = package["targets"].as_array().unwrap();
        let is_program =
            |target: &Value| target["kind"].as_array().unwrap().contains(&"bin".into());
        package["publish"].is_null() && targets.iter().any(is_program)
    };
    let programs = packages.iter().filter(has_program);
    programs.map(|package| package["name"].as_str().unwrap().to_owned()).collect()
}

/// Packages of others that are compiled for this one alone on x86-64: two versions are two.
fn third_party(package: &str) -> usize {
    let tree = cargo(&[
        "tree",
        "--package",
        package,
        "--edges=normal,build",
        "--target=x86_64-unknown-linux-gnu",
        "--prefix=none",
        "--no-dedupe",
    ]);
    // A package of the workspace is followed by its folder.
    let others = tree.lines().filter(|line| !line.contains("(/"));
    let others: BTreeSet<&str> = others.collect();
    others.len()
}

#[test]
fn no_program_and_no_library_of_the_sdk_gets_more_crates_of_others() {
    // Beside this file, which the compiler names from the root.
    let path = crates().parent().unwrap().join(file!());
    let path = path.with_extension("txt");
    let mut names = programs();
    names.extend(SDK.map(str::to_owned));
    names.sort();
    let found: Vec<String> =
        names.iter().map(|name| format!("{name} {}\n", third_party(name))).collect();
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        fs::write(&path, found.concat()).unwrap();
        return;
    }
    let held = fs::read_to_string(&path).unwrap();
    let held: Vec<String> = held.lines().map(|line| format!("{line}\n")).collect();
    let other = |these: &[String], those: &[String]| -> String {
        let lines = these.iter().filter(|line| !those.contains(line));
        lines.map(String::as_str).collect()
    };
    assert!(
        held == found,
        "crates of others, as held in {}:\n{}as found:\n{}\
         Which: `cargo tree -p PACKAGE -e normal,build --prefix none --no-dedupe | sort -u`, here \
         and on the commit before. Why: `cargo tree -p PACKAGE -e normal,build -i CRATE`.\n\
         Fewer: `JOULEBUS_WRITE=1 cargo test -p joulebus-tests third_party` \
         holds them. More: only with a reason in the commit.",
        path.display(),
        other(&held, &found),
        other(&found, &held)
    );
}
