//! Links of documents lead to files and headings, the summary has every page of the book once, and
//! the tests that RELIABILITY.md names exist.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Component, Path, PathBuf};

/// Directories that are not of the repository.
const SKIPPED: [&str; 3] = [".git", "node_modules", "target"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Documents, by their paths from the root. The changelog names what there was before.
fn pages() -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut open = vec![PathBuf::new()];
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(root().join(&directory)).unwrap() {
            let entry = entry.unwrap();
            let path = directory.join(entry.file_name());
            let name = path.to_str().unwrap().to_owned();
            if entry.file_type().unwrap().is_dir() {
                if !SKIPPED.iter().any(|skipped| path.ends_with(skipped)) {
                    open.push(path);
                }
            } else if name.ends_with(".md") && name != "CHANGELOG.md" {
                found.insert(name, fs::read_to_string(root().join(path)).unwrap());
            }
        }
    }
    found
}

/// Lines of a page with their numbers, without blocks of code.
fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut is_code = false;
    (1..).zip(text.lines()).filter(move |(_, line)| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        !is_code && !is_fence
    })
}

/// A line without its inline code.
fn without_code(line: &str) -> String {
    line.split('`').step_by(2).collect::<Vec<_>>().join("``")
}

/// The anchors of a page's headings, as GitHub and mdBook make them.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = prose(text).filter_map(|(_, line)| {
        let title = line.trim_start_matches('#');
        (title.len() < line.len()).then(|| title.strip_prefix(' ')).flatten()
    });
    let kept = |c: &char| c.is_alphanumeric() || ['-', '_', ' '].contains(c);
    let anchor = |title: &str| -> String { title.trim().chars().filter(kept).collect() };
    headings.map(|title| anchor(title).to_lowercase().replace(' ', "-")).collect()
}

/// The targets of a line's links and pictures.
fn links(line: &str) -> Vec<&str> {
    let after = |(begin, end): (&'static str, char)| {
        line.split(begin).skip(1).filter_map(move |rest| Some(rest.split_once(end)?.0))
    };
    [("](", ')'), ("src=\"", '"'), ("srcset=\"", '"')].into_iter().flat_map(after).collect()
}

/// A path without `.` and `..`.
fn normal(path: &Path) -> PathBuf {
    let mut normal = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => assert!(normal.pop(), "{path:?} leaves the repository"),
            Component::CurDir => {}
            part => normal.push(part),
        }
    }
    normal
}

#[test]
fn links_of_documents_lead_to_files_and_headings() {
    let pages = pages();
    let (mut checked, mut broken) = (0, Vec::new());
    for (path, text) in &pages {
        for (number, line) in prose(text) {
            for link in links(&without_code(line)) {
                let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
                // Pages of crates link into the book by its address.
                let (from, target) = match target.split_once("joulebus/blob/main/") {
                    Some((_, target)) => (Path::new(""), target),
                    None => (Path::new(path).parent().unwrap(), target),
                };
                if target.contains("://") || target.starts_with("mailto:") {
                    continue;
                }
                checked += 1;
                let target = match target {
                    "" => PathBuf::from(path),
                    _ => normal(&from.join(target)),
                };
                let is_there = match pages.get(target.to_str().unwrap()) {
                    Some(page) => anchor.is_empty() || anchors(page).contains(anchor),
                    None => root().join(&target).exists(),
                };
                if !is_there {
                    broken.push(format!("{path}:{number}: {link}"));
                }
            }
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
    assert!(checked > 300, "only {checked} links were found");
}

#[test]
fn the_summary_has_every_page_of_the_book_once() {
    let mut pages = pages();
    let summary = pages.remove("docs/SUMMARY.md").unwrap();
    let listed = summary.lines().flat_map(links).filter(|link| !link.is_empty());
    let path = |link| normal(&Path::new("docs").join(link)).to_str().unwrap().to_owned();
    let mut listed: Vec<String> = listed.map(path).collect();
    listed.sort();
    let pages: Vec<String> = pages.into_keys().filter(|path| path.starts_with("docs/")).collect();
    assert_eq!(listed, pages);
}

/// Lines of a package's sources that declare a function or a module, and its files.
fn declared(package: &str) -> Vec<String> {
    let name = match package {
        "" => "joulebus-tests".to_owned(),
        "joulebus" => package.to_owned(),
        package => format!("joulebus-{package}"),
    };
    let mut open = vec![root().join("crates"), root().join("tests")];
    let (mut found, mut below) = (Vec::new(), None);
    while let Some(path) = open.pop() {
        let manifest = fs::read_to_string(path.join("Cargo.toml")).unwrap_or_default();
        if below.is_none() && manifest.contains(&format!("\nname = \"{name}\"\n")) {
            open.clear();
            below = Some(path.clone());
        }
        if path.is_dir() {
            let entries = fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path());
            open.extend(entries.filter(|path| !path.ends_with("target")));
        } else if let Some(file) = below.as_ref().and_then(|below| path.strip_prefix(below).ok()) {
            found.push(file.display().to_string());
            let text = fs::read_to_string(&path).unwrap_or_default();
            let lines = text.lines().filter(|line| line.contains("fn ") || line.contains("mod "));
            found.extend(lines.map(str::to_owned));
        }
    }
    assert!(!found.is_empty(), "there is no package {name}");
    found
}

#[test]
fn the_tests_that_reliability_names_exist() {
    let page = fs::read_to_string(root().join("RELIABILITY.md")).unwrap();
    let (mut known, mut checked, mut missing) = (BTreeMap::new(), 0, Vec::new());
    let (mut is_of_tests, mut last) = (false, 0);
    for (number, line) in prose(&page).filter(|(_, line)| line.starts_with("| ")) {
        let cell = line.trim_end_matches([' ', '|']).rsplit('|').next().unwrap();
        // Between the head of a table and its first row lies a line.
        if number > last + 2 {
            is_of_tests = cell.trim() == "test";
        }
        last = number;
        // A name alone is of the package before it, or of the tests of the system.
        let mut package = "";
        for name in cell.split('`').skip(1).step_by(2).filter(|_| is_of_tests) {
            checked += 1;
            let (target, test) = match name.split_once(' ') {
                Some(both) => both,
                None if name.contains('/') => (name, ""),
                None => ("", name),
            };
            if target.starts_with("tools/") {
                missing.extend((!root().join(target).exists()).then_some((number, name)));
                continue;
            }
            if !target.is_empty() {
                package = target.split('/').next().unwrap();
            }
            let lines = known.entry(package).or_insert_with(|| declared(package));
            // The parts of a filter are parts of the names of modules and functions.
            let is_there = |part: &str| lines.iter().any(|line| line.contains(part));
            if !test.split("::").all(is_there) {
                missing.push((number, name));
            }
        }
    }
    assert!(missing.is_empty(), "RELIABILITY.md names what is not there: {missing:#?}");
    assert!(checked > 150, "only {checked} names were found");
}
