//! Pages of the book that tests write.

use std::fs;
use std::path::Path;

/// Compares `tables` with those of `file`, by its path in the repository, that have the same first
/// lines, in this order. With `JOULEBUS_WRITE=1` writes them there instead.
///
/// # Panics
/// The file has something else, or lacks a table.
#[track_caller]
pub fn assert_page_contains(file: &str, tables: &[String]) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(file);
    let old = fs::read_to_string(&path).expect("the page can be read");
    let (mut new, mut rest) = (String::new(), old.as_str());
    for table in tables {
        let head = table.lines().next().unwrap_or_default();
        let found = rest.split_once(head).unwrap_or_else(|| panic!("{file}: no table {head}"));
        let (before, after) = found;
        // An empty line ends a table.
        let (_, after) = after.split_once("\n\n").unwrap_or_default();
        new += &format!("{before}{table}\n");
        rest = after;
    }
    new += rest;
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        fs::write(&path, &new).expect("the page can be written");
    } else {
        let remedy = "run this test again with JOULEBUS_WRITE=1";
        assert!(old == new, "{file} says something else: {remedy}");
    }
}
