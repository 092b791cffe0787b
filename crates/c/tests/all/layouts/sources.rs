//! What the sources of `joulebus-wire` say of structs, fields and bits.

use std::fs;

use super::root;

/// The comments of `joulebus-wire`.
pub(crate) struct Sources {
    text: String,
}

impl Sources {
    pub(crate) fn read() -> Self {
        let folder = root().join("crates/wire/src");
        let mut files: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        files.sort();
        let texts = files.iter().map(|path| fs::read_to_string(path).unwrap());
        Self {
            text: texts.collect(),
        }
    }

    /// What is said of a struct or module, and the lines of its body.
    fn item(&self, begin: &str) -> (String, Vec<&str>) {
        let at = self
            .text
            .find(begin)
            .unwrap_or_else(|| panic!("no {begin:?} in joulebus-wire"));
        let above: Vec<&str> = self.text[..at].lines().collect();
        let body = self.text[at..].lines().skip(1);
        let body = body.take_while(|line| *line != "}").collect();
        (comment(&above), body)
    }

    /// What is said of a struct.
    pub(crate) fn of_struct(&self, name: &str) -> String {
        self.item(&format!("pub struct {name} {{\n")).0
    }

    /// What is said of a field.
    pub(crate) fn of_field(&self, of: &str, field: &str) -> String {
        let (_, body) = self.item(&format!("pub struct {of} {{\n"));
        of_line(&body, &format!("pub {field}:"))
    }

    /// What is said of a bit.
    pub(crate) fn of_bit(&self, module: &str, name: &str) -> String {
        let (_, body) = self.item(&format!("pub mod {module} {{\n"));
        of_line(&body, &format!("pub const {name}:"))
    }
}

fn of_line(body: &[&str], begin: &str) -> String {
    let begins = |line: &&str| line.trim_start().starts_with(begin);
    let at = body.iter().position(begins);
    comment(&body[..at.unwrap_or_else(|| panic!("no {begin:?}"))])
}

/// The comment at the end of these lines, without links.
fn comment(above: &[&str]) -> String {
    let mut lines: Vec<&str> = Vec::new();
    for line in above.iter().rev().map(|line| line.trim_start()) {
        match line.strip_prefix("///") {
            Some(said) => lines.insert(0, said.trim()),
            None if line.starts_with("#[") => {}
            None => break,
        }
    }
    assert!(!lines.is_empty(), "without a comment: {:?}", above.last());
    let said = lines.join("\n").replace("[`", "`").replace("`]", "`");
    let said = said.replace("crate::", "").replace('`', "");
    // Paragraphs stay, lines do not.
    let paragraphs = said.split("\n\n").map(|part| part.replace('\n', " "));
    paragraphs.collect::<Vec<_>>().join("\n")
}
