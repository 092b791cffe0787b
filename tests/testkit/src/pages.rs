//! Pages of the book that tests write.

use std::fs;
use std::path::Path;

/// Compares what stands in `file`, by its path in the repository, between its two lines that have
/// `mark`. With `JOULEBUS_WRITE=1` writes `text` there instead.
///
/// # Panics
/// The file has something else, or lacks the lines.
#[track_caller]
pub fn assert_page_contains(file: &str, mark: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(file);
    let old = fs::read_to_string(&path).expect("the page can be read");
    let mut parts = old.splitn(3, mark);
    let mut part = || parts.next().unwrap_or_else(|| panic!("{file}: no two {mark}"));
    let (before, between, after) = (part(), part(), part());
    let (end_of_line, _) = between.split_once('\n').expect("a mark ends its line");
    let (_, begin_of_line) = between.rsplit_once('\n').expect("a mark begins its line");
    let new = format!("{before}{mark}{end_of_line}\n{text}{begin_of_line}{mark}{after}");
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        fs::write(&path, &new).expect("the page can be written");
    } else {
        let remedy = "run this test again with JOULEBUS_WRITE=1";
        assert!(old == new, "{file} says something else: {remedy}");
    }
}
