//! The layouts of shared memory in C. The header is made from `joulebus-wire`, and a compiled C
//! program prints its compiler's offsets.
//!
//! `JOULEBUS_WRITE=1 cargo test -p joulebus-c --test all layouts` writes the header again.

mod compiled;
mod header;

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// Compares a file with what it is made from, or writes it.
fn compare(file: &str, made: &str) {
    let path = root().join(file);
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        fs::write(&path, made).unwrap();
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    let differs = found.lines().zip(made.lines()).position(|(found, made)| found != made);
    let line = differs.unwrap_or_else(|| found.lines().count().min(made.lines().count()));
    assert!(
        found == made,
        "{file} is not what the sources say, from line {} on: found {:?}, made {:?}; write it again with \
         JOULEBUS_WRITE=1 cargo test -p joulebus-c --test all layouts",
        line + 1,
        found.lines().nth(line),
        made.lines().nth(line),
    );
}

/// `DropCounts` as `drop_counts`.
fn snake(name: &str) -> String {
    let mut snake = String::new();
    for (at, letter) in name.char_indices() {
        if at > 0 && letter.is_uppercase() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// A comment of `joulebus-wire` as text: without links, a line for each paragraph.
fn text_of(doc: &str) -> String {
    let lines: Vec<&str> = doc.lines().map(str::trim).collect();
    let text = lines.join("\n").replace("[`", "`").replace("`]", "`");
    let text = text.replace("crate::", "").replace('`', "");
    let paragraphs = text.split("\n\n").map(|part| part.replace('\n', " "));
    paragraphs.collect::<Vec<_>>().join("\n")
}
