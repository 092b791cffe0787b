//! Allowed dependencies between crates: a drawing and a table of ARCHITECTURE.md, and the table of
//! crates.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use super::{Member, members, members_below, root};

/// For each package, what it depends on.
pub(super) type Graph = BTreeMap<String, BTreeSet<String>>;

const ARCHITECTURE: &str = "ARCHITECTURE.md";
/// Each crate, its purpose, and what it must not know.
const CRATES: &str = "docs/reference/crates.md";

fn page(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap()
}

/// The crates, and the benchmarks.
fn described() -> Vec<Member> {
    let mut members = members();
    members.extend(members_below(&root().join("benches")));
    members
}

/// The crates in the drawing, line by line from the top.
fn drawing() -> Vec<Vec<String>> {
    let page = page(ARCHITECTURE);
    let (_, after) = page.split_once("## Crate layout\n\n```\n").unwrap();
    let known: BTreeSet<String> = described().into_iter().map(|member| member.name).collect();
    let crates_of = |line: &str| -> Vec<String> {
        let words = line.split_whitespace().map(str::to_owned);
        words.filter(|word| known.contains(word)).collect()
    };
    let (drawing, _) = after.split_once("\n```").unwrap();
    drawing.lines().map(crates_of).collect()
}

/// The rows of the table of `path` whose first column has the head `first`: the first and the last
/// column.
fn table(path: &str, first: &str) -> Vec<(String, String)> {
    let page = page(path);
    let (_, after) = page.split_once(&format!("\n| {first} |")).unwrap();
    let rows = after.lines().skip(2);
    let rows = rows.take_while(|line| line.starts_with('|')).map(|line| {
        let columns: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let name = columns[0].trim_matches('`').to_owned();
        (name, columns.last().unwrap().to_string())
    });
    rows.collect()
}

/// The packages of `Cargo.lock`, those of the workspace without dev-dependencies, which the lock
/// file does not distinguish. Crates have the names of ARCHITECTURE.md.
pub(super) fn graph() -> Graph {
    let lock = fs::read_to_string(root().join("Cargo.lock")).unwrap();
    let mut graph = Graph::new();
    let ours: BTreeSet<String> = described().into_iter().map(|member| member.name).collect();
    // `lab` is a crate of crates.io, too.
    let outside = |name: &str| match ours.contains(name) {
        true => format!("{name} of crates.io"),
        false => name.to_owned(),
    };
    for package in lock.split("[[package]]").skip(1) {
        let quoted: Vec<&str> = package.split('"').skip(1).step_by(2).collect();
        let list = package.split_once("dependencies = [");
        let list = list.map_or("", |(_, list)| list);
        let names = list.split('"').skip(1).step_by(2);
        // If the lock file has two versions of a package, the name is followed by the version.
        let names = names.filter_map(|name| Some(outside(name.split(' ').next()?)));
        graph.entry(outside(quoted[0])).or_default().extend(names);
    }
    for Member { name, manifest, .. } in described() {
        let (_, after) = manifest.split_once("\n[dependencies]\n").unwrap_or_default();
        let table = after.split("\n[").next().unwrap();
        let dependencies = table.lines().filter_map(|line| {
            let end = line.find(['.', ' ', '='])?;
            let name = &line[..end];
            let ours = name.strip_prefix("joulebus-").unwrap_or(name);
            Some(ours.to_owned()).filter(|name| !name.starts_with('#'))
        });
        graph.insert(name, dependencies.collect());
    }
    graph
}

/// Direct and indirect dependencies of a package.
pub(super) fn reached(graph: &Graph, package: &str) -> BTreeSet<String> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&String> = graph[package].iter().collect();
    while let Some(name) = open.pop() {
        if reached.insert(name.clone()) {
            open.extend(graph.get(name).into_iter().flatten());
        }
    }
    reached
}

#[test]
fn a_crate_reaches_only_lower_lines_of_the_diagram() {
    let (drawing, graph) = (drawing(), graph());
    let line = |name: &str| {
        let found = drawing.iter().position(|line| line.iter().any(|other| other == name));
        found.unwrap_or_else(|| panic!("the diagram in ARCHITECTURE.md lacks {name}"))
    };
    let members = described();
    for Member { name, .. } in &members {
        let (above, reached) = (line(name), reached(&graph, name));
        for below in members.iter().filter(|member| reached.contains(&member.name)) {
            assert!(line(&below.name) > above, "{name} reaches {}", below.name);
        }
        assert!(
            !reached.contains("joulebus") && !reached.contains("bench"),
            "{name} reaches the program or the benchmarks"
        );
    }
}

/// The column "must not know" of the table of crates, by the words of the table of ARCHITECTURE.md.
#[test]
fn a_crate_does_not_reach_what_it_must_not_know() {
    let (graph, members) = (graph(), described());
    let words = table(ARCHITECTURE, "who must not know");
    let mut used = BTreeSet::new();
    for (name, unknown) in table(CRATES, "crate") {
        if !members.iter().any(|member| member.name == name) {
            continue;
        }
        let reached = reached(&graph, &name);
        for (word, targets) in &words {
            if !unknown.split(", ").any(|part| part == word) {
                continue;
            }
            used.insert(word);
            for target in targets.split(", ").map(|name| name.trim_matches('`')) {
                if target == "any crate" {
                    let ours = members.iter().find(|member| reached.contains(&member.name));
                    assert!(ours.is_none(), "{name} reaches {}", ours.unwrap().name);
                    continue;
                }
                assert!(graph.contains_key(target), "there is no {target}");
                assert!(
                    !reached.contains(target),
                    "{name} must not know {word}, and reaches {target}"
                );
            }
        }
    }
    assert_eq!(used.len(), words.len(), "of {words:?} only {used:?} are used");
    // Allowed edges are found: the closures are not empty.
    for (name, target) in [("publisher", "iceoryx2"), ("plan", "energy")] {
        assert!(reached(&graph, name).contains(target), "{name}");
    }
}

#[test]
fn the_program_crate_has_few_dependencies() {
    let members: BTreeSet<String> = described().into_iter().map(|member| member.name).collect();
    for name in &graph()["program"] {
        let light = ["config", "files", "predictor", "settings"].contains(&name.as_str());
        assert!(light || !members.contains(name), "program depends on {name}");
    }
}

#[test]
fn the_table_of_crates_describes_all_crates() {
    let rows = table(CRATES, "crate");
    for Member { name, .. } in described() {
        assert!(rows.iter().any(|(row, _)| *row == name), "{CRATES} does not mention {name}");
    }
}
