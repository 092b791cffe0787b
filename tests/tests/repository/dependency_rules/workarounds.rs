//! The table of workarounds for defects of iceoryx2, in `docs/decisions/iceoryx2.md`.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::{crates, sources};

/// One row of the table.
struct Workaround {
    file: String,
    symbol: String,
    /// Numbers of issues and pull requests, or what was searched.
    upstream: String,
    /// The first release without the defect.
    cured_in: Option<(u32, u32, u32)>,
    tests: Vec<String>,
    /// The gate leaves the tests out.
    at_night: bool,
}

fn root() -> PathBuf {
    crates().parent().unwrap().to_owned()
}

/// The words in backticks of a cell.
fn quoted(cell: &str) -> impl Iterator<Item = String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned)
}

fn version(text: &str) -> (u32, u32, u32) {
    let mut parts = text.split('.').map(|part| part.parse().unwrap());
    let mut next = || parts.next().unwrap();
    (next(), next(), next())
}

fn table() -> Vec<Workaround> {
    let page = fs::read_to_string(root().join("docs/decisions/iceoryx2.md")).unwrap();
    let rows = page.lines().filter(|line| line.starts_with("| `crates/"));
    let parse = |row: &str| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [file, symbol, _, upstream, cured_in, tests] = cells[..] else {
            panic!("six cells are expected: {row}");
        };
        Workaround {
            file: quoted(file).next().unwrap(),
            symbol: quoted(symbol).next().unwrap(),
            upstream: upstream.to_owned(),
            cured_in: (cured_in != "none").then(|| version(cured_in)),
            tests: quoted(tests).collect(),
            at_night: tests.contains("at night"),
        }
    };
    let table: Vec<_> = rows.map(parse).collect();
    assert!(table.len() >= 10, "the table has {} rows", table.len());
    table
}

/// The numbers that `text` names as `#1234`.
fn numbers(text: &str) -> BTreeSet<u32> {
    let after = text.split('#').skip(1);
    let digits = after.map(|rest| rest.split(|c: char| !c.is_ascii_digit()).next().unwrap());
    digits.filter_map(|digits| digits.parse().ok()).collect()
}

fn pinned() -> (u32, u32, u32) {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let (_, rest) = manifest
        .split_once("\niceoryx2 = { version = \"=")
        .expect("iceoryx2 is pinned to an exact version");
    version(rest.split('"').next().unwrap())
}

#[test]
fn a_workaround_is_where_the_table_states_with_its_numbers_and_its_test() {
    let all: String = ["crates", "tests/tests", "tests/simulator"]
        .iter()
        .flat_map(|directory| sources(&root().join(directory)))
        .map(|(_, text)| text)
        .collect();
    for row in table() {
        let text = fs::read_to_string(root().join(&row.file)).expect(&row.file);
        let is_there = |prefix: &str| text.contains(&format!("{prefix}{}", row.symbol));
        let symbol = format!("{}: {}", row.file, row.symbol);
        assert!(["fn ", "struct ", "const "].map(is_there).contains(&true), "{symbol}");
        let missing: Vec<u32> =
            numbers(&row.upstream).difference(&numbers(&text)).copied().collect();
        assert!(missing.is_empty(), "{symbol} does not name {missing:?}");
        assert!(
            !numbers(&row.upstream).is_empty() || row.upstream.contains("searched"),
            "{symbol}: no number, and nothing that was searched"
        );
        assert!(!row.tests.is_empty(), "{symbol}: no test");
        for test in &row.tests {
            let (before, _) = all.split_once(&format!("fn {test}(")).expect(test);
            let attributes = &before[before.rfind("#[test]").expect(test)..];
            let is_ignored = attributes.contains("#[ignore");
            assert_eq!(row.at_night, is_ignored, "{symbol}: {test}");
        }
    }
}

#[test]
fn a_workaround_that_the_pinned_release_does_not_need_is_gone() {
    for row in table() {
        let Some(cured_in) = row.cured_in else {
            continue;
        };
        assert!(
            pinned() < cured_in,
            "iceoryx2 {:?} has cured what {} in {} works around: delete it, and its row",
            pinned(),
            row.symbol,
            row.file
        );
    }
}

#[test]
fn every_number_of_iceoryx2_that_the_bus_names_is_in_the_table() {
    let known: BTreeSet<u32> = table().iter().flat_map(|row| numbers(&row.upstream)).collect();
    for (path, text) in sources(&crates().join("host/bus/src")) {
        let unknown: Vec<u32> = numbers(&text).difference(&known).copied().collect();
        let path = path.strip_prefix(root()).unwrap_or(Path::new(""));
        assert!(unknown.is_empty(), "{path:?} names {unknown:?}");
    }
}
