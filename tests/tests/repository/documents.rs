//! Packages, targets and sources that documents, scripts and comments name exist. Links of
//! documents lead somewhere, tables are whole, and pages of the book are short. Comments have at
//! most 100 columns.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Component, Path, PathBuf};

use serde_json::Value;

use super::packaging::{metadata, name, packages};

/// Directories that are not of the repository.
const SKIPPED: [&str; 3] = [".git", "node_modules", "target"];

/// Cargo's options that select a target.
const KINDS: [&str; 4] = ["--test", "--bin", "--example", "--bench"];

/// Maximum width of a comment's line, as of code.
const MAX_COLUMNS: usize = 100;

/// Maximum number of words of a page of the book.
const MAX_WORDS: usize = 1_500;

/// Pages that a test writes from the sources: they may be long.
const GENERATED: [&str; 1] = ["docs/reference/layout.md"];

/// Pages that are too long, with their words. This list may only shrink.
const LONG: [(&str, usize); 0] = [];

/// Beginnings of the comments that enclose a generated part of a page.
const MARKS: [&str; 11] = [
    "api",
    "figures:",
    "benchmark:",
    "cards",
    "doors",
    "keys",
    "limits",
    "metrics",
    "paths",
    "verbs",
    "end of",
];

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
    for (begin, kept) in [("cargo ", 0), ("`… ", 0), ("`--", 2), ("busy.py ", 0)] {
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
        // Pages of crates link into the book.
        for link in text.split("joulebus/blob/main/").skip(1) {
            let named = link.split([')', '#', '"', '\n']).next().unwrap();
            if !root().join(named).exists() {
                missing.push(format!("{path}: {named}"));
            }
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
    for path in files() {
        let begins: &[&str] = match path.rsplit_once('.').map(|(_, extension)| extension) {
            Some("rs" | "js") => &["//"],
            Some("c" | "cpp" | "h" | "hpp") => &["//", "/*", " *"],
            Some("py" | "sh" | "toml" | "yml") => &["#"],
            _ if path == ".ci/run" => &["#"],
            _ => continue,
        };
        let text = fs::read_to_string(root().join(&path)).unwrap();
        for (number, line) in (1..).zip(text.lines()) {
            // Columns of a table of commands are wider.
            let is_comment = |begin: &&str| line.trim_start().starts_with(begin.trim_start());
            if !begins.iter().any(is_comment) || line.trim_start().starts_with("#   ") {
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

/// A message has a sentence for what was found, and one for the remedy.
#[test]
fn messages_of_errors_have_no_semicolons() {
    let (mut checked, mut wrong) = (0, Vec::new());
    for (path, text) in documents() {
        if !path.ends_with(".rs") || !path.contains("/src/") {
            continue;
        }
        for rest in text.split("#[error(").skip(1) {
            let mut parts = rest.split('"').skip(1);
            let mut message = parts.next().unwrap_or_default().to_owned();
            while message.ends_with('\\') {
                message = format!("{message}\"{}", parts.next().unwrap());
            }
            checked += 1;
            if message.contains("; ") {
                wrong.push(format!("{path}: {message}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(checked > 400, "only {checked} messages were found");
}

/// Documents at the top level and pages of the book: path and text.
fn pages() -> Vec<(String, String)> {
    let is_page = |path: &str| {
        let is_top = !path.contains('/') && path != "CHANGELOG.md";
        path.ends_with(".md") && (is_top || path.starts_with("docs/"))
    };
    documents().into_iter().filter(|(path, _)| is_page(path)).collect()
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
    let pages: BTreeMap<String, String> = pages().into_iter().collect();
    let (mut checked, mut broken) = (0, Vec::new());
    for (path, text) in &pages {
        for (number, line) in prose(text) {
            for link in links(&without_code(line)) {
                let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
                if target.contains("://") || target.starts_with("mailto:") {
                    continue;
                }
                checked += 1;
                let target = match target {
                    "" => PathBuf::from(path),
                    _ => normal(&Path::new(path).parent().unwrap().join(target)),
                };
                let page = pages.get(target.to_str().unwrap());
                let is_there = match page {
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
fn tables_of_documents_are_whole() {
    let (mut checked, mut broken) = (0, Vec::new());
    for (path, text) in pages() {
        // Lines and cells of the table so far.
        let (mut last, mut rows, mut cells) = (0, 0, 0);
        for (number, line) in prose(&text) {
            let line = line.trim();
            if !line.starts_with('|') {
                continue;
            }
            let found = line.replace("\\|", "").matches('|').count();
            let is_rule = line.contains("---") && line.chars().all(|c| "|-: ".contains(c));
            rows = if number == last + 1 { rows + 1 } else { 0 };
            if rows == 0 {
                (cells, checked) = (found, checked + 1);
            }
            if (rows == 1) != is_rule {
                broken.push(format!("{path}:{number}: the rule belongs below the head"));
            }
            if found != cells {
                broken.push(format!("{path}:{number}: another number of cells than the head"));
            }
            last = number;
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
    assert!(checked > 100, "only {checked} tables were found");
}

#[test]
fn the_summary_has_every_page_of_the_book_once() {
    let summary = fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    let mut listed: Vec<String> = summary
        .lines()
        .flat_map(links)
        .filter(|link| !link.is_empty())
        .map(|link| normal(&Path::new("docs").join(link)).to_str().unwrap().to_owned())
        .collect();
    listed.sort();
    let mut pages: Vec<String> = pages().into_iter().map(|(path, _)| path).collect();
    pages.retain(|path| path.starts_with("docs/") && path != "docs/SUMMARY.md");
    pages.sort();
    assert_eq!(listed, pages);
}

/// Words outside of generated parts. A word has a letter or a digit.
fn words(text: &str) -> usize {
    let mut is_generated = false;
    let written = text.lines().filter(|line| {
        let comment = line.trim().strip_prefix("<!-- ");
        let is_mark = comment.is_some_and(|text| MARKS.iter().any(|mark| text.starts_with(mark)));
        is_generated ^= is_mark;
        !is_generated && !is_mark
    });
    let is_word = |word: &&str| word.contains(char::is_alphanumeric);
    written.map(|line| line.split_whitespace().filter(is_word).count()).sum()
}

#[test]
fn pages_of_the_book_are_short() {
    let allowed: BTreeMap<&str, usize> = LONG.into_iter().collect();
    let (mut wrong, mut all) = (Vec::new(), 0);
    for (path, text) in pages() {
        let words = words(&text);
        if !path.starts_with("docs/") || GENERATED.contains(&path.as_str()) {
            continue;
        }
        all += words;
        match allowed.get(path.as_str()) {
            Some(&most) if words > most => {
                wrong.push(format!("{path}: {words} words, {most} before"));
            }
            Some(_) if words <= MAX_WORDS => wrong.push(format!("{path} is short now: LONG")),
            None if words > MAX_WORDS => wrong.push(format!("{path}: {words} words: split it")),
            _ => {}
        }
    }
    println!("{all} words");
    assert!(wrong.is_empty(), "{wrong:#?}");
}
