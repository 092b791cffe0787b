//! What a key of a config file is.

use std::fmt::Write as _;

use serde::Serialize;

use crate::cpus;

/// A key of a config file: what it means and what it may be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Key {
    /// Where it stands, sections separated by dots. Keys of a platform file begin with
    /// `platform.`, which is left out in that file.
    pub path: &'static str,
    /// The file that it belongs to.
    pub file: File,
    /// What its value is and may be.
    pub kind: ValueKind,
    /// Unit of the value; empty where there is none.
    pub unit: &'static str,
    /// Its value when it is left out.
    pub default: DefaultValue,
    /// What it does, in a sentence.
    pub doc: &'static str,
}

/// A kind of config file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum File {
    /// The file of the fleet.
    Fleet,
    /// A platform's file. The key may stand under `[[platform]]` in the fleet's file too, and then
    /// wins over the platform's file.
    Platform,
}

/// What a value is and may be; ends of ranges are allowed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ValueKind {
    /// A whole number.
    Integer {
        /// Least value.
        min: i64,
        /// Greatest value.
        max: i64,
    },
    /// A number; a whole one may be written without a point.
    Number {
        /// Least value.
        min: f64,
        /// Greatest value.
        max: f64,
    },
    /// One of a few words.
    Choice(&'static [&'static str]),
    /// Text.
    Text(TextRule),
    /// A list of robot ids (`7`) and ranges of them, both ends included (`"0-99"`).
    Robots,
}

/// What a text may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TextRule {
    /// 1 to 32 letters, digits, `-` and `_`.
    Name,
    /// 1 to 8 lower-case letters, digits and `_`.
    Prefix,
    /// An absolute path of at most 60 bytes; `{uid}` stands for the user's number.
    Root,
    /// A path, relative to the file that it stands in, or empty.
    OptionalPath,
    /// A platform file: a path, or `builtin:` and a name.
    PlatformFile,
    /// `persistence`, `builtin:` and a name, or the path of a model file.
    Model,
    /// CPUs and ranges of them, each once, or empty.
    Cpus,
}

/// The value of a key that is left out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum DefaultValue {
    /// None: the key must be given (battery keys: if any of them is).
    Required,
    /// None: the key may be left out.
    Unset,
    /// A whole number.
    Integer(i64),
    /// A number.
    Number(f64),
    /// A text or a word.
    Text(&'static str),
}

impl Key {
    /// The key's name without its section.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.path.rsplit('.').next().unwrap_or(self.path)
    }

    /// The path as written in the key's own file: without `platform.` in a platform file.
    #[must_use]
    pub fn path_in_file(&self) -> &'static str {
        match self.file {
            File::Fleet => self.path,
            File::Platform => self.path.strip_prefix("platform.").unwrap_or(self.path),
        }
    }

    /// What the value may be, in words.
    #[must_use]
    pub fn range(&self) -> String {
        match self.kind {
            ValueKind::Integer { min, max } => format!("whole number, {min} to {max}"),
            ValueKind::Number { min, max } => format!("{min} to {max}"),
            ValueKind::Choice(words) => {
                let quoted: Vec<String> = words.iter().map(|word| format!("{word:?}")).collect();
                quoted.join(" or ")
            }
            ValueKind::Text(rule) => rule.words().to_owned(),
            ValueKind::Robots => {
                "list of ids 0 to 4294967295 and ranges of them, like [\"0-99\", 120]".to_owned()
            }
        }
    }

    /// The default, in words.
    #[must_use]
    pub fn default_words(&self) -> String {
        match self.default {
            DefaultValue::Required => "required".to_owned(),
            DefaultValue::Unset => "default: not set".to_owned(),
            DefaultValue::Integer(value) => format!("default {value}"),
            DefaultValue::Number(value) => format!("default {value}"),
            DefaultValue::Text(text) => format!("default {text:?}"),
        }
    }

    /// Unit, range and default on one line, as in the comments of the shipped files.
    #[must_use]
    pub fn facts(&self) -> String {
        let mut facts = String::new();
        if !self.unit.is_empty() {
            // Writing to a String cannot fail.
            let _ = write!(facts, "{}; ", self.unit);
        }
        facts + &format!("{}; {}", self.range(), self.default_words())
    }
}

impl TextRule {
    /// The rule in words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Name => "1 to 32 letters, digits, - and _",
            Self::Prefix => "1 to 8 lower-case letters, digits and _",
            Self::Root => "absolute path of at most 60 bytes; {uid} stands for the user's number",
            Self::OptionalPath => "path, relative to this file, or empty",
            Self::PlatformFile => "path, relative to this file, or \"builtin:<name>\"",
            Self::Cpus => "CPUs like \"1\" or \"2-3,6\", each once, or empty",
            Self::Model => "\"persistence\", \"builtin:<name>\", or a path relative to this file",
        }
    }

    /// Whether `text` keeps the rule.
    #[must_use]
    pub fn allows(self, text: &str) -> bool {
        let made_of = |allowed: fn(char) -> bool, most: usize| {
            !text.is_empty() && text.len() <= most && text.chars().all(allowed)
        };
        match self {
            Self::Name => made_of(
                |letter| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_'),
                32,
            ),
            Self::Prefix => made_of(
                |letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_',
                8,
            ),
            Self::Root => {
                text.starts_with('/')
                    && text.len() <= 60
                    && !text.contains('\0')
                    && !text.split('/').any(|part| part == "..")
                    && text
                        .replace("{uid}", "")
                        .chars()
                        .all(|letter| !matches!(letter, '{' | '}'))
            }
            Self::OptionalPath => !text.contains('\0'),
            Self::Cpus => cpus::parse(text).is_some(),
            Self::PlatformFile | Self::Model => !text.is_empty() && !text.contains('\0'),
        }
    }
}
