//! Promises of the public API that the compiler does not check.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Crates whose names users write.
const SDK: [&str; 7] = [
    "core/wire",
    "publisher",
    "consumer",
    "core/plan",
    "planning/planner",
    "core/predictor",
    "core/energy",
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn files(folder: &Path, extension: &str, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") {
            files(&path, extension, found);
        } else if path.extension().is_some_and(|found| found == extension) {
            found.push(path);
        }
    }
}

/// The identifier that a text begins with.
fn identifier(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_');
    &text[..end.unwrap_or(text.len())]
}

/// Public fields that can be NaN, and methods, by type.
type Names = BTreeMap<String, [BTreeSet<String>; 2]>;

fn collect(source: &str, names: &mut Names) {
    let mut of = String::new();
    for line in source.lines().map(str::trim_start) {
        if let Some((_, rest)) = line.split_once("struct ") {
            identifier(rest).clone_into(&mut of);
        } else if line.starts_with("impl") {
            let named = line.split(" for ").last().unwrap();
            let named = named.trim_start_matches("impl").trim_start();
            let named = match named.strip_prefix('<') {
                Some(generic) => generic.split_once("> ").map_or("", |(_, rest)| rest),
                None => named,
            };
            identifier(named).clone_into(&mut of);
        }
        let Some(public) = line.strip_prefix("pub ") else {
            continue;
        };
        let [fields, methods] = names.entry(of.clone()).or_default();
        let function = public.trim_start_matches("const ").strip_prefix("fn ");
        if let Some(function) = function {
            methods.insert(identifier(function).to_owned());
        } else if let Some((field, kind)) = public.split_once(": ")
            && ["f32", "f64", "[f32", "[f64"].iter().any(|number| kind.starts_with(number))
        {
            fields.insert(field.to_owned());
        }
    }
}

/// An unknown number is NaN in a row's field, and absent from its accessor. With one name for both,
/// a pair of parentheses would decide.
#[test]
fn no_method_has_the_name_of_a_field_that_can_be_nan() {
    let mut checked = 0;
    for of in SDK {
        let mut sources = Vec::new();
        files(&root().join("crates").join(of).join("src"), "rs", &mut sources);
        let mut names = Names::new();
        for source in sources {
            collect(&fs::read_to_string(source).unwrap(), &mut names);
        }
        for (name, [fields, methods]) in names {
            checked += fields.len();
            let both: Vec<_> = fields.intersection(&methods).collect();
            assert!(both.is_empty(), "{of}: {name} has fields and methods {both:?}");
        }
    }
    assert!(checked > 100, "only {checked} fields were found");
}

#[test]
fn the_check_of_names_finds_a_shared_one() {
    let mut names = Names::new();
    let source = "rows! {\n    pub struct A: \"a\", 8 {\n        pub power_w: f32,\n    }\n}\n\
                  impl A {\n    pub const fn power_w(&self) -> Option<f32> {\n";
    collect(source, &mut names);
    collect("impl<'a> fmt::Debug for B<'a> {\n    pub fn soc(mut self)", &mut names);
    let [fields, methods] = &names["A"];
    assert_eq!((fields, fields.len()), (methods, 1));
    assert!(names["B"][1].contains("soc"));
}

/// Each public type's page has an example, or a link to the one that shows it.
#[test]
fn each_public_type_of_an_sdk_has_an_example_or_names_one() {
    let mut types = 0;
    for of in ["publisher", "consumer", "planning/planner", "core/predictor"] {
        let mut sources = Vec::new();
        files(&root().join("crates").join(of).join("src"), "rs", &mut sources);
        for source in sources {
            let text = fs::read_to_string(source).unwrap();
            // An item, its attributes and its comment have no empty line between them.
            for item in text.split("\n\n") {
                let mut lines = item.lines().filter_map(|line| line.strip_prefix("pub "));
                let is_type = |line: &&str| {
                    ["struct ", "enum ", "trait ", "type "]
                        .iter()
                        .any(|word| line.starts_with(word))
                };
                let Some(line) = lines.find(is_type) else {
                    continue;
                };
                types += 1;
                let shows = item.contains("/// ```") || item.contains(" has an example");
                assert!(shows, "{of}: {line} has no example, and no \"[`X`] has an example.\"");
            }
        }
    }
    assert!(types > 50, "only {types} types were found");
}

/// `main` prints its error in `Debug` form: of a `Box<dyn Error>` these are the names of fields, of
/// `anyhow::Error` the message and its causes.
#[test]
fn programs_that_are_shown_print_errors_as_sentences() {
    let root = root();
    let mut pages = vec![root.join("README.md")];
    files(&root.join("docs"), "md", &mut pages);
    files(&root.join("crates"), "md", &mut pages);
    files(&root.join("crates"), "rs", &mut pages);
    let mut shown = 0;
    for page in pages {
        let is_example = page.parent().is_some_and(|folder| folder.ends_with("examples"));
        let is_source = !is_example && page.extension().is_some_and(|extension| extension == "rs");
        let begin = if is_source { "//! fn main() -> " } else { "fn main() -> " };
        let text = fs::read_to_string(&page).unwrap();
        for main in text.lines().filter(|line| line.starts_with(begin)) {
            shown += 1;
            assert!(!main.contains("Box<dyn"), "{}: {main}", page.display());
        }
    }
    assert!(shown > 25, "only {shown} programs were found");
}
