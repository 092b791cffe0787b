//! Requirements of crates.io and of users for every published crate: metadata, licences, README,
//! versions of all dependencies, and every embedded file inside the package.

use std::fs;
use std::path::{Component, Path, PathBuf};
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

fn folder(package: &Value) -> PathBuf {
    let manifest = Path::new(package["manifest_path"].as_str().unwrap());
    manifest.parent().unwrap().to_owned()
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn only_tests_examples_the_simulator_and_the_python_package_are_unpublished() {
    let metadata = metadata(false);
    let mut kept: Vec<&str> = packages(&metadata)
        .filter(|package| package["publish"] == serde_json::json!([]))
        .map(name)
        .filter(|name| !name.starts_with("joulebus-simulated-"))
        .collect();
    kept.sort_unstable();
    let expected = [
        "joulebus-examples",
        "joulebus-python",
        "joulebus-simulator",
        "joulebus-testkit",
        "joulebus-testkit-channels",
        "joulebus-testkit-fleets",
        "joulebus-testkit-networks",
        "joulebus-tests",
    ];
    assert_eq!(kept, expected);
}

#[test]
fn every_published_crate_has_complete_metadata() {
    let metadata = metadata(false);
    let mut missing = Vec::new();
    for package in published(&metadata) {
        let text = |key: &str| package[key].as_str().unwrap_or_default();
        let list = |key: &str| package[key].as_array().map_or(0, Vec::len);
        for (what, is_there) in [
            ("a description of 20 to 200 bytes", (20..=200).contains(&text("description").len())),
            ("1 to 5 keywords", (1..=5).contains(&list("keywords"))),
            ("1 to 5 categories", (1..=5).contains(&list("categories"))),
            ("a repository", text("repository").starts_with("https://")),
            ("the licence", text("license") == "MIT OR Apache-2.0"),
            ("a README.md", text("readme") == "README.md"),
            (
                "the licences' texts",
                ["LICENSE-MIT", "LICENSE-APACHE"]
                    .iter()
                    .all(|file| folder(package).join(file).is_file()),
            ),
            ("a rust-version", !text("rust_version").is_empty()),
        ] {
            if !is_there {
                missing.push(format!("{}: {what}", name(package)));
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
}

/// Two crates with the same description could not be distinguished in a search.
#[test]
fn descriptions_of_crates_are_unique() {
    let metadata = metadata(false);
    let mut descriptions: Vec<&str> =
        published(&metadata).iter().filter_map(|package| package["description"].as_str()).collect();
    let count = descriptions.len();
    descriptions.sort_unstable();
    descriptions.dedup();
    assert_eq!(descriptions.len(), count);
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

/// Files outside a crate's directory are not in its package. Symbolic links inside it are packaged
/// as files.
#[test]
fn embedded_files_are_inside_their_crate() {
    let metadata = metadata(false);
    for package in published(&metadata) {
        let folder = folder(package);
        let mut files = Vec::new();
        sources(&folder.join("src"), &mut files);
        for file in files {
            let text = fs::read_to_string(&file).unwrap();
            // Unit tests are compiled only in the repository, and are at the end of a file.
            let shipped = text.split("#[cfg(test)]\nmod tests").next().unwrap();
            let code = shipped.lines().filter(|line| !line.trim_start().starts_with("//"));
            let shipped: String = code.flat_map(|line| [line, "\n"]).collect();
            for embedded in ["include_str!(", "include_bytes!(", "include!("]
                .iter()
                .flat_map(|call| shipped.split(call).skip(1))
                .filter_map(|rest| rest.trim_start().strip_prefix('"')?.split('"').next())
            {
                let depth = file.strip_prefix(&folder).unwrap().components().count() - 1;
                let up = Path::new(embedded).components();
                let up = up.filter(|part| *part == Component::ParentDir).count();
                assert!(up <= depth, "{} embeds {embedded}", file.display());
                assert!(file.parent().unwrap().join(embedded).is_file(), "{embedded}");
            }
            // `joulebus new` looks whether a clone is there.
            let looks = file.ends_with("cli/src/new/mod.rs");
            assert!(
                looks || !shipped.contains("CARGO_MANIFEST_DIR"),
                "{} requires a file of the repository",
                file.display()
            );
        }
    }
}

/// Major and minor number of `1.89` or `1.89.0`.
fn version(text: &str) -> (u32, u32) {
    let mut parts = text.split('.').map(|part| part.parse().unwrap());
    (parts.next().unwrap(), parts.next().unwrap_or(0))
}

#[test]
fn no_dependency_requires_a_newer_compiler_than_rust_version() {
    let metadata = metadata(true);
    let ours = packages(&metadata).find(|package| package["source"].is_null());
    let promised = version(ours.unwrap()["rust_version"].as_str().unwrap());
    let newer: Vec<String> = packages(&metadata)
        .filter(|package| !package["source"].is_null())
        .filter_map(|package| Some((name(package), package["rust_version"].as_str()?)))
        .filter(|(_, needed)| version(needed) > promised)
        .map(|(name, needed)| format!("{name} requires {needed}"))
        .collect();
    assert!(newer.is_empty(), "rust-version is {promised:?}, but {newer:?}");
}

/// Files that match a path, whose last part may have a `*`.
fn matching(path: &Path) -> Vec<PathBuf> {
    let pattern = path.file_name().unwrap().to_str().unwrap();
    let (begin, end) = pattern.split_once('*').unwrap_or((pattern, ""));
    let is_whole = !pattern.contains('*');
    let entries = fs::read_dir(path.parent().unwrap());
    let entries = entries.into_iter().flatten().map(Result::unwrap);
    let matches = |entry: &fs::DirEntry| {
        let name = entry.file_name().into_string().unwrap();
        match is_whole {
            true => name == pattern,
            false => name.starts_with(begin) && name.ends_with(end),
        }
    };
    entries.filter(matches).map(|entry| entry.path()).filter(|path| path.is_file()).collect()
}

/// `tools/deb.sh` builds and installs the package; this finds what would stop it, or is missing.
#[test]
fn the_debian_package_has_every_program_and_unit_and_names_files_that_exist() {
    let metadata = metadata(false);
    let package = packages(&metadata).find(|package| name(package) == "joulebus");
    let package = package.unwrap();
    let (deb, folder) = (&package["metadata"]["deb"], folder(package));
    let script = fs::read_to_string(folder.join("../../tools/deb.sh")).unwrap();
    let mut programs = Vec::new();
    let mut units = Vec::new();
    for asset in deb["assets"].as_array().unwrap() {
        let [source, to, mode] = [0, 1, 2].map(|part| asset[part].as_str().unwrap());
        if let Some(made) = source.strip_prefix("target/release/deb/") {
            let made = made.split(['/', '*']).next().unwrap();
            assert!(script.contains(made), "tools/deb.sh makes no {source}");
        } else if let Some(program) = source.strip_prefix("target/release/") {
            assert_eq!((to, mode), ("usr/bin/", "755"), "{source}");
            programs.push(program.to_owned());
        } else {
            let found = matching(&folder.join(source));
            assert!(!found.is_empty(), "{source} does not exist");
            assert_eq!(mode, "644", "{source}");
            units.extend(found.into_iter().filter(|_| to.contains("systemd/system")));
        }
    }
    let targets = published(&metadata);
    let targets = targets.iter().flat_map(|package| package["targets"].as_array().unwrap());
    let is_program = |target: &&Value| target["kind"] == serde_json::json!(["bin"]);
    let mut expected: Vec<String> =
        targets.filter(is_program).map(|target| name(target).to_owned()).collect();
    expected.sort_unstable();
    assert_eq!(programs, expected);
    assert!(script.contains("tools/programs.sh"), "{script}");
    let listed = Command::new(folder.join("../../tools/programs.sh")).output();
    let listed = String::from_utf8(listed.unwrap().stdout).unwrap();
    assert_eq!(listed.lines().collect::<Vec<_>>(), programs);
    let all = matching(&folder.join("../../configs/systemd/*.service"));
    assert_eq!(units.len(), all.len(), "{units:?}, expected {all:?}");
    for unit in units {
        let text = fs::read_to_string(&unit).unwrap();
        let started = text.split("ExecStart=/usr/bin/").nth(1).unwrap();
        let program = started.split(' ').next().unwrap().to_owned();
        assert!(programs.contains(&program), "{}: {program}", unit.display());
    }
    let licence = deb["license-file"][0].as_str().unwrap();
    assert!(folder.join(licence).is_file(), "{licence}");
    let scripts = folder.join(deb["maintainer-scripts"].as_str().unwrap());
    for script in ["postinst", "prerm", "postrm"] {
        let text = fs::read_to_string(scripts.join(script)).unwrap();
        assert!(text.starts_with("#!/bin/sh\nset -e\n"), "{script}");
    }
}

/// A test that reads an ignored file passes here and fails in a clean clone. Ignored below
/// `crates` are only what Python and maturin make.
#[test]
fn no_file_that_a_test_may_read_is_ignored_by_git() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let verb = "ls-files --others --ignored --exclude-standard --directory crates tests tools";
    let listed = Command::new("git").args(verb.split(' ')).current_dir(root).output();
    let listed = listed.unwrap();
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let listed = String::from_utf8(listed.stdout).unwrap();
    let made = |path: &&str| !path.ends_with("__pycache__/") && !path.ends_with(".so");
    let found: Vec<&str> = listed.lines().filter(made).collect();
    assert!(found.is_empty(), "{found:?}: change .gitignore or move them");
}
