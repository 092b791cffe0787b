//! Checked values of the keys, with the location where each was set.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::sync::Arc;

use toml_writer::{TomlStringBuilder, WriteTomlValue as _};

use crate::key::{DefaultValue, Key};
use crate::table;

/// A file and a line of it, from 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Location {
    pub(crate) file: Arc<str>,
    /// Directory to which paths in the file are relative. `None` for built-in files.
    pub(crate) directory: Option<Arc<PathBuf>>,
    pub(crate) line: usize,
}

impl fmt::Display for Location {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}:{}", self.file, self.line)
    }
}

/// A value within its key's range.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Integer(i64),
    Number(f64),
    Text(String),
    Flag(bool),
    Robots(Vec<RangeInclusive<u32>>),
    /// Each with the line of its own.
    Texts(Vec<(String, usize)>),
    Scalars(Vec<Scalar>),
}

/// An element of a list that may have any.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(untagged)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Scalar {
    Integer(i64),
    Number(f64),
    Text(String),
    Flag(bool),
}

impl fmt::Display for Value {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(value) => write!(out, "{value}"),
            Self::Number(value) => write!(out, "{value:?}"),
            Self::Text(text) => out.write_str(&quoted(text)),
            Self::Flag(flag) => write!(out, "{flag}"),
            Self::Texts(texts) => {
                let texts: Vec<String> = texts.iter().map(|(text, _)| quoted(text)).collect();
                write!(out, "[{}]", texts.join(", "))
            }
            Self::Scalars(scalars) => write!(out, "{scalars:?}"),
            Self::Robots(ranges) => {
                let ranges: Vec<String> = ranges.iter().map(crate::robots::text).collect();
                write!(out, "[{}]", ranges.join(", "))
            }
        }
    }
}

/// A key in a file.
#[derive(Debug, Clone)]
struct Entry {
    /// `None` if the value was refused: it is not checked further.
    value: Option<Value>,
    location: Location,
}

/// The keys of one file, or of a platform's file with its overrides.
#[derive(Debug, Clone, Default)]
pub(crate) struct Values {
    entries: BTreeMap<String, Entry>,
    /// The sections that the file has.
    pub(crate) sections: BTreeMap<String, Location>,
    /// Tables of lists, and entries of sections with free names, by their path.
    pub(crate) children: BTreeMap<String, Vec<Child>>,
}

/// A table of a list, or an entry of a section with free names.
#[derive(Debug, Clone)]
pub(crate) struct Child {
    pub(crate) name: Option<String>,
    pub(crate) location: Location,
    pub(crate) values: Values,
}

impl Values {
    pub(crate) fn set(&mut self, path: &str, value: Option<Value>, location: Location) {
        self.entries.insert(path.to_owned(), Entry { value, location });
    }

    /// Overrides by the keys that `stronger` sets.
    pub(crate) fn override_with(&mut self, stronger: Self) {
        self.entries.extend(stronger.entries);
    }

    /// True if a file sets the key, validly or not.
    pub(crate) fn names(&self, path: &str) -> bool {
        self.entries.contains_key(path)
    }

    /// True if a file sets any key with this prefix.
    pub(crate) fn names_any(&self, prefix: &str) -> bool {
        self.entries.keys().any(|path| path.starts_with(prefix))
    }

    pub(crate) fn location(&self, path: &str) -> Option<&Location> {
        self.entries.get(path).map(|entry| &entry.location)
    }

    /// The value set, else the default. `None` if it is missing or was refused.
    pub(crate) fn get(&self, path: &str) -> Option<Value> {
        match self.entries.get(path) {
            Some(entry) => entry.value.clone(),
            None => preset(table::find(path)?),
        }
    }

    pub(crate) fn number(&self, path: &str) -> Option<f64> {
        match self.get(path)? {
            Value::Number(value) => Some(value),
            Value::Integer(value) => Some(value as f64),
            _ => None,
        }
    }

    /// An integer within the range of `T`.
    pub(crate) fn integer<T: TryFrom<i64>>(&self, path: &str) -> Option<T> {
        match self.get(path)? {
            Value::Integer(value) => T::try_from(value).ok(),
            _ => None,
        }
    }

    pub(crate) fn text(&self, path: &str) -> Option<String> {
        match self.get(path)? {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    pub(crate) fn robots(&self) -> Vec<RangeInclusive<u32>> {
        match self.get("platform.robots") {
            Some(Value::Robots(ranges)) => ranges,
            _ => Vec::new(),
        }
    }

    /// The key with its value and location, for messages.
    pub(crate) fn quote(&self, path: &str) -> String {
        let Some(key) = table::find(path) else {
            return format!("`{path}`");
        };
        let value = self.get(path).map_or_else(|| "not set".to_owned(), |value| value.to_string());
        let unit = if key.unit.is_empty() { String::new() } else { format!(" {}", key.unit) };
        let location =
            self.location(path).map_or_else(|| "default".to_owned(), Location::to_string);
        format!("`{}` = {value}{unit} ({location})", key.path_in_file())
    }
}

/// A text as TOML, on one line.
pub(crate) fn quoted(text: &str) -> String {
    let mut quoted = String::new();
    // Writing to a String cannot fail.
    let _ = TomlStringBuilder::new(text).as_basic().write_toml_value(&mut quoted);
    quoted
}

pub(crate) fn preset(key: &Key) -> Option<Value> {
    match key.default {
        DefaultValue::Required | DefaultValue::Unset => None,
        DefaultValue::Integer(value) => Some(Value::Integer(value)),
        DefaultValue::Number(value) => Some(Value::Number(value)),
        DefaultValue::Text(text) => Some(Value::Text(text.to_owned())),
        DefaultValue::Flag(flag) => Some(Value::Flag(flag)),
    }
}
