//! Explanations of the keys.

use serde::Serialize;

use crate::key::{DefaultValue, File, Key};
use crate::remedy;
use crate::table;
use crate::values::{Value, preset};

/// Explanation of one key.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explanation {
    /// The key, with its sections.
    pub key: &'static str,
    /// The file that it belongs to.
    pub file: File,
    /// Unit, empty if there is none.
    pub unit: &'static str,
    /// Allowed values, as text.
    pub range: String,
    /// True if it is required.
    pub required: bool,
    /// The default, if there is one.
    pub default: Option<String>,
    /// Its effect.
    pub doc: &'static str,
}

/// No such key or section.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` is not a key of a config. {remedy}")]
#[allow(missing_docs)] // The messages name the fields.
pub struct UnknownKey {
    pub key: String,
    pub remedy: String,
}

impl From<&Key> for Explanation {
    fn from(key: &Key) -> Self {
        Self {
            key: key.path,
            file: key.file,
            unit: key.unit,
            range: key.range(),
            required: key.default == DefaultValue::Required,
            default: preset(key).map(|value| match value {
                Value::Text(text) => text,
                Value::Number(number) => number.to_string(),
                value => value.to_string(),
            }),
            doc: key.doc,
        }
    }
}

/// The explanations of one key, of a section (`tick`), or of every key.
///
/// # Errors
/// There is no such key or section. The error names the nearest.
pub fn explanations(key: Option<&str>) -> Result<Vec<Explanation>, UnknownKey> {
    Ok(asked_for(key)?.into_iter().map(Explanation::from).collect())
}

/// The same as text, one paragraph per key.
///
/// # Errors
/// There is no such key or section. The error names the nearest.
pub fn explain(key: Option<&str>) -> Result<String, UnknownKey> {
    let paragraph = |key: &Key| {
        let file = match key.file {
            File::Fleet | File::Platform => String::new(),
            file => format!("   ({})", file.name()),
        };
        format!("{}{file}\n  {}\n  {}\n", key.path, key.doc, key.facts())
    };
    let paragraphs: Vec<String> = asked_for(key)?.into_iter().map(paragraph).collect();
    Ok(paragraphs.join("\n"))
}

fn asked_for(path: Option<&str>) -> Result<Vec<&'static Key>, UnknownKey> {
    let Some(path) = path else {
        return Ok(table::keys().collect());
    };
    if let Some(key) = table::find(path) {
        return Ok(vec![key]);
    }
    let of_section = table::keys().filter(|key| key.below(path).is_some());
    let in_platform_file =
        table::keys().filter(|key| key.file == File::Platform && key.path_in_file() == path);
    let found: Vec<&Key> = of_section.chain(in_platform_file).collect();
    if found.is_empty() {
        return Err(UnknownKey {
            key: path.to_owned(),
            remedy: remedy::unknown_key(None, path, None),
        });
    }
    Ok(found)
}
