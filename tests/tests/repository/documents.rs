//! Packages, targets and sources that documents, scripts and comments name exist. Comments have at
//! most 100 columns.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::packaging::{metadata, name, packages};

/// Directories that are not of the repository.
const SKIPPED: [&str; 3] = [".git", "node_modules", "target"];

/// Cargo's options that select a target.
const KINDS: [&str; 4] = ["--test", "--bin", "--example", "--bench"];

/// Maximum width of a comment's line, as of code.
const MAX_COLUMNS: usize = 100;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Every file of the repository, by its path from the root.
fn files() -> Vec<String> {
    let mut found = Vec::new();
    let mut open = vec![PathBuf::new()];
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(root().join(&directory)).unwrap() {
            let entry = entry.unwrap();
            let path = directory.join(entry.file_name());
            if !entry.file_type().unwrap().is_dir() {
                found.push(path.to_str().unwrap().to_owned());
            } else if !SKIPPED.iter().any(|name| path.ends_with(name)) {
                open.push(path);
            }
        }
    }
    found
}

/// Documents, sources and scripts: path and text. The changelog names what there was before.
fn documents() -> Vec<(String, String)> {
    let extensions = ["md", "py", "rs", "sh", "toml", "yml"];
    let is_document = |path: &String| {
        let extension = path.rsplit_once('.').map_or("", |(_, extension)| extension);
        path == ".ci/run" || (path != "CHANGELOG.md" && extensions.contains(&extension))
    };
    let read = |path: String| {
        let text = fs::read_to_string(root().join(&path)).unwrap();
        (path, text)
    };
    files().into_iter().filter(is_document).map(read).collect()
}

/// The arguments of each command: to the end of its line, or of the inline code that it stands in,
/// which may go on in the next line. Arguments alone, as inline code, are a shortened command.
fn commands(text: &str) -> Vec<&str> {
    let mut found = Vec::new();
    // The last number of bytes belongs to the arguments.
    for (begin, kept) in [("cargo ", 0), ("`… ", 0), ("`--", 2), ("busy.sh ", 0)] {
        for (place, _) in text.match_indices(begin) {
            let (before, rest) = text.split_at(place + begin.len() - kept);
            let line = before.rsplit('\n').next().unwrap();
            let is_inline = line.matches('`').count() % 2 == 1;
            let ends = |c: char| "`\"|;#)".contains(c) || (c == '\n' && !is_inline);
            found.push(rest.split(ends).next().unwrap());
        }
    }
    found
}

/// Packages of joulebus, and targets by kind and name, that arguments of cargo select. `NAME` and
/// variables are neither.
fn selected(arguments: &str) -> (Vec<&str>, Vec<(&str, &str)>) {
    let words = arguments.split_whitespace();
    let words: Vec<&str> =
        words.filter(|word| !word.starts_with("//")).take_while(|word| *word != "--").collect();
    let is_of_name =
        |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || ['-', '_'].contains(&c);
    let (mut packages, mut targets) = (Vec::new(), Vec::new());
    for pair in words.windows(2) {
        let (option, value) = (pair[0], pair[1].trim_matches(['\'', '.', ',', ':']));
        let is_name = value.starts_with(|c: char| c.is_ascii_lowercase());
        if !is_name || !value.chars().all(is_of_name) {
            continue;
        }
        if ["-p", "--package"].contains(&option) && value.starts_with("joulebus") {
            packages.push(value);
        } else if KINDS.contains(&option) {
            targets.push((option.trim_start_matches('-'), value));
        }
    }
    (packages, targets)
}

fn targets(package: &Value) -> BTreeSet<(&str, &str)> {
    let targets = package["targets"].as_array().unwrap().iter();
    let by_kind = targets.flat_map(|target| {
        let kinds = target["kind"].as_array().unwrap().iter();
        kinds.map(move |kind| (kind.as_str().unwrap(), name(target)))
    });
    by_kind.collect()
}

#[test]
fn a_command_ends_with_its_line_or_its_inline_code() {
    let text = "a `cargo test -p joulebus-bus\n/// --test bus` --test none\n\
                cargo run --bin joulebus-sim -- --bin none\n";
    let found: Vec<_> = commands(text).into_iter().map(selected).collect();
    let expected =
        [(vec!["joulebus-bus"], vec![("test", "bus")]), (vec![], vec![("bin", "joulebus-sim")])];
    assert_eq!(found, expected);
}

#[test]
fn packages_and_targets_of_commands_exist() {
    let metadata = metadata(false);
    let known: BTreeMap<&str, BTreeSet<(&str, &str)>> =
        packages(&metadata).map(|package| (name(package), targets(package))).collect();
    let (mut checked, mut missing) = (0, Vec::new());
    for (path, text) in documents() {
        // The words of a command, as Python has them.
        let text = text.replace("\", \"", " ");
        for command in commands(&text) {
            let (of, targets) = selected(command);
            checked += of.len() + targets.len();
            let unknown = of.iter().filter(|package| !known.contains_key(**package));
            missing.extend(unknown.map(|package| format!("{path}: no package {package}")));
            for target in targets {
                let exists = known.iter().any(|(package, targets)| {
                    (of.is_empty() || of.contains(package)) && targets.contains(&target)
                });
                if !exists {
                    let (kind, name) = target;
                    missing.push(format!("{path}: no {kind} {name} of {of:?}"));
                }
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
    assert!(checked > 200, "only {checked} names in commands were found");
}

/// The paths that `{a,b}` within a path stands for.
fn expanded(path: &str) -> Vec<String> {
    let Some((before, rest)) = path.split_once('{') else {
        return vec![path.to_owned()];
    };
    let (choices, after) = rest.split_once('}').expect(path);
    choices.split(',').flat_map(|choice| expanded(&format!("{before}{choice}{after}"))).collect()
}

/// Paths in backticks may be shortened at their beginning: `tick/infer.rs` of ARCHITECTURE.md is
/// the file of `fleet`.
#[test]
fn sources_that_documents_and_comments_name_exist() {
    let files: Vec<String> = files().iter().map(|path| format!("/{path}")).collect();
    let (mut checked, mut missing) = (0, Vec::new());
    for (path, text) in documents() {
        let is_source = path.ends_with(".rs");
        if !is_source && !path.ends_with(".md") {
            continue;
        }
        let lines = text.lines().filter(|line| !is_source || line.trim_start().starts_with("//"));
        let quoted = lines.flat_map(|line| line.split('`').skip(1).step_by(2));
        let is_path = |quoted: &&str| {
            let is_source = quoted.ends_with(".rs") || quoted.starts_with("crates/");
            let is_inside = quoted.contains("/src/") || quoted.contains("/tests/");
            (is_source || is_inside) && !quoted.contains([' ', '*', '…', '<', '$'])
        };
        for named in quoted.filter(is_path).flat_map(expanded) {
            checked += 1;
            let end = format!("/{}", named.trim_end_matches('/'));
            let directory = format!("{end}/");
            let exists = |file: &String| file.ends_with(&end) || file.contains(&directory);
            if !files.iter().any(exists) {
                missing.push(format!("{path}: {named}"));
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
    assert!(checked > 60, "only {checked} paths were found");
}

/// Pages of decisions name the tests of a promise below a heading of its own.
#[test]
fn tests_that_decisions_name_exist() {
    let documents = documents();
    let mut functions = BTreeSet::new();
    for (_, text) in documents.iter().filter(|(path, _)| !path.ends_with(".md")) {
        for begin in ["fn ", "def "] {
            functions.extend(text.split(begin).skip(1).filter_map(|rest| rest.split('(').next()));
        }
    }
    let (mut checked, mut missing) = (0, Vec::new());
    for (path, text) in documents.iter().filter(|(path, _)| path.starts_with("docs/decisions/")) {
        let (_, after) = text.split_once("\n## Tests\n").unwrap_or_default();
        let section = after.split("\n## ").next().unwrap();
        for name in section.split('`').skip(1).step_by(2) {
            checked += 1;
            if !functions.contains(name) {
                missing.push(format!("{path}: {name}"));
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
    assert!(checked > 60, "only {checked} names of tests were found");
}

#[test]
fn lines_of_comments_have_at_most_100_columns() {
    let (mut checked, mut long) = (0, Vec::new());
    for (path, text) in documents() {
        if !path.ends_with(".rs") {
            continue;
        }
        for (number, line) in (1..).zip(text.lines()) {
            if !line.trim_start().starts_with("//") {
                continue;
            }
            checked += 1;
            if line.chars().count() > MAX_COLUMNS {
                long.push(format!("{path}:{number}: {line}"));
            }
        }
    }
    assert!(long.is_empty(), "{long:#?}");
    assert!(checked > 10_000, "only {checked} lines were found");
}
