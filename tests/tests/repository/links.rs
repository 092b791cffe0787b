//! Links of documents lead to files and headings, and the summary has every page of the book once.

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
