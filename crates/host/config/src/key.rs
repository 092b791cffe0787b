//! Description of a key of a config file.

use std::fmt::Write as _;

use joulebus_settings::{OpenCircuit, bounds};
use serde::Serialize;

use crate::cpus;

/// A key of a config file: its meaning and allowed values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Key {
    /// Its path, sections separated by dots. Keys of a platform file begin with `platform.`, which
    /// is omitted in that file. `|` separates the names of a section that has several. `*` is any
    /// name.
    pub path: &'static str,
    /// The file that it belongs to.
    pub file: File,
    /// Kind and range of its value.
    pub kind: ValueKind,
    /// Unit of the value, empty if there is none.
    pub unit: &'static str,
    /// Its default.
    pub default: DefaultValue,
    /// Its effect, in a sentence.
    pub doc: &'static str,
}

/// A kind of config file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum File {
    /// The file of the fleet.
    Fleet,
    /// A platform's file. The fleet's file may set the key too, under `[[platform]]`, and then
    /// overrides the platform's file.
    Platform,
    /// The file of `joulebus bridge`.
    Bridge,
    /// The file of `joulebus link`.
    Link,
    /// The file of receivers of alarms, of `joulebus serve --webhooks`.
    Webhooks,
}

impl File {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Fleet, Self::Platform, Self::Bridge, Self::Link, Self::Webhooks];

    /// Its name, as `joulebus config schema` takes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fleet => "fleet",
            Self::Platform => "platform",
            Self::Bridge => "bridge",
            Self::Link => "link",
            Self::Webhooks => "webhooks",
        }
    }

    /// Path of the keys that stand outside of all sections.
    pub(crate) const fn root(self) -> &'static str {
        match self {
            Self::Platform => "platform",
            _ => "",
        }
    }

    /// True if the file may set the key. A fleet's file may set those of platforms.
    #[must_use]
    pub fn allows(self, key: &Key) -> bool {
        self == key.file || (self, key.file) == (Self::Fleet, Self::Platform)
    }
}

/// Kind and range of a value. Bounds are included.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ValueKind {
    /// An integer.
    Integer {
        /// Minimum.
        min: i64,
        /// Maximum.
        max: i64,
    },
    /// A number. The decimal point is optional.
    Number {
        /// Minimum.
        min: f64,
        /// Maximum.
        max: f64,
    },
    /// One of a few words.
    Choice(&'static [&'static str]),
    /// Text.
    Text(TextRule),
    /// true or false.
    Flag,
    /// A list of texts.
    Texts {
        /// Format of each.
        rule: TextRule,
        /// Minimum number.
        min: usize,
        /// Maximum number.
        max: usize,
    },
    /// A list of words out of a few.
    Words(&'static [&'static str]),
    /// A list of numbers, texts, `true` and `false`.
    Scalars,
    /// A robot id (`7`) or, as text, a range of them (`"0-99"`).
    Ids,
    /// A list of robot ids (`7`) and ranges of them, both ends included (`"0-99"`).
    Robots,
}

/// Format of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TextRule {
    /// 1 to 32 letters, digits, `-` and `_`.
    Name,
    /// 1 to 8 lower-case letters, digits and `_`.
    Prefix,
    /// An absolute path. `{uid}` is replaced by the uid.
    Root,
    /// `auto`, a path, relative to the file that contains it, or empty.
    StateFile,
    /// Rising voltages, separated by commas, or empty.
    Voltages,
    /// A platform file: a path, or `builtin:` and a name.
    PlatformFile,
    /// `persistence`, `builtin:` and a name, or the path of a model file.
    Model,
    /// CPUs and ranges of them, each once, or empty.
    Cpus,
    /// Pairs of a quantity and its column, separated by commas.
    Columns,
    /// Kinds of findings, separated by commas.
    Findings,
    /// 1 to 100 bytes that are one level of an MQTT topic and no pattern.
    Source,
    /// 1 to 200 bytes that are one level of an MQTT topic.
    Level,
    /// 1 to 64 letters, digits, `-`, `_` and `.`.
    Link,
    /// Prefixes of etcd's keys.
    Prefixes,
    /// The path of a file, relative to the file that names it.
    File,
    /// An address of HTTP or HTTPS.
    Web,
    /// Any other: its reader checks it.
    Any(&'static str),
}

/// Default of a key.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum DefaultValue {
    /// None: the key is required (battery keys: if any of them is set).
    Required,
    /// None: the key is optional.
    Unset,
    /// An integer.
    Integer(i64),
    /// A number.
    Number(f64),
    /// A text or a word.
    Text(&'static str),
    /// true or false.
    Flag(bool),
}

impl Key {
    /// The key's name without its section.
    pub fn name(&self) -> &'static str {
        self.path.rsplit('.').next().unwrap_or(self.path)
    }

    /// The path as written in the key's own file: without `platform.` in a platform file.
    pub fn path_in_file(&self) -> &'static str {
        match self.file {
            File::Platform => self.path.strip_prefix("platform.").unwrap_or(self.path),
            _ => self.path,
        }
    }

    /// The rest of the key's path after `path`: empty for the key itself, `None` if it is not
    /// below.
    pub(crate) fn below(&self, path: &str) -> Option<&'static str> {
        if path.is_empty() {
            return Some(self.path);
        }
        path.split('.').try_fold(self.path, |rest, name| {
            let (names, rest) = rest.split_once('.').unwrap_or((rest, ""));
            names.split('|').any(|one| one == name && !one.is_empty()).then_some(rest)
        })
    }

    /// Its paths: several if a section has several names.
    pub fn paths(&self) -> Vec<String> {
        self.path.split('.').fold(vec![String::new()], |paths, names| {
            let joined = |path: &String, name| match path.as_str() {
                "" => String::from(name),
                path => format!("{path}.{name}"),
            };
            let each = |path| names.split('|').map(move |name| joined(path, name));
            paths.iter().flat_map(each).collect()
        })
    }

    /// Allowed values, as text.
    pub fn range(&self) -> String {
        match self.kind {
            ValueKind::Integer { min, max } => format!("whole number, {min} to {max}"),
            ValueKind::Number { min, max } => format!("{min} to {max}"),
            ValueKind::Choice(words) => quoted(words, " or "),
            ValueKind::Words(words) => format!("list of {}", quoted(words, ", ")),
            ValueKind::Text(rule) => rule.words().to_owned(),
            ValueKind::Texts { rule, min, max } => match (min, max) {
                (0, usize::MAX) => format!("list of {}", rule.words()),
                _ => format!("list of {min} to {max}: {}", rule.words()),
            },
            ValueKind::Flag => "true or false".to_owned(),
            ValueKind::Scalars => "list of numbers, texts, true and false".to_owned(),
            ValueKind::Ids => {
                "id like 7, or with {id} in the name a range like \"0-99\"".to_owned()
            }
            ValueKind::Robots => {
                "list of ids 0 to 4294967295 and ranges of them, like [\"0-99\", 120]".to_owned()
            }
        }
    }

    /// The default, as text.
    pub fn default_words(&self) -> String {
        match self.default {
            DefaultValue::Required => "required".to_owned(),
            DefaultValue::Unset => "default: not set".to_owned(),
            DefaultValue::Integer(value) => format!("default {value}"),
            DefaultValue::Number(value) => format!("default {value}"),
            DefaultValue::Text(text) => format!("default {text:?}"),
            DefaultValue::Flag(flag) => format!("default {flag}"),
        }
    }

    /// Unit, range and default on one line, as in the comments of the shipped files.
    pub fn facts(&self) -> String {
        let mut facts = String::new();
        if !self.unit.is_empty() {
            // Writing to a String cannot fail.
            let _ = write!(facts, "{}; ", self.unit);
        }
        facts + &format!("{}; {}", self.range(), self.default_words())
    }
}

fn quoted(words: &[&str], between: &str) -> String {
    let quoted: Vec<String> = words.iter().map(|word| format!("{word:?}")).collect();
    quoted.join(between)
}

/// The voltages that a text lists, if they are a table of open-circuit voltages.
pub(crate) fn voltages(text: &str) -> Option<Vec<f64>> {
    let volts: Option<Vec<f64>> = text.split(',').map(|volts| volts.trim().parse().ok()).collect();
    let inside =
        |volts: &Vec<f64>| volts.iter().all(|voltage_v| bounds::OPEN_CIRCUIT_V.contains(voltage_v));
    let volts = volts.filter(inside)?;
    // Resistance and deviation are checked as keys of their own.
    OpenCircuit::new(&volts, 0.0, 0.1).map(|_| volts)
}

impl TextRule {
    /// The format as text.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Name => "1 to 32 letters, digits, - and _",
            Self::Prefix => "1 to 8 lower-case letters, digits and _",
            Self::Root => {
                "absolute path, of at most 51 bytes with the fleet's name and the prefix; {uid} is \
                 replaced by the user id"
            }
            Self::StateFile => "\"auto\", a path relative to this file, or empty",
            Self::Voltages => "2 to 21 rising voltages like \"3.0, 3.6, 4.2\", or empty",
            Self::PlatformFile => "path, relative to this file, or \"builtin:<name>\"",
            Self::Cpus => "CPUs like \"1\" or \"2-3,6\", each once, or empty",
            Self::Columns => "pairs like \"time=t,voltage_V=u\"",
            Self::Findings => "kinds of findings like \"sign,unit\"",
            Self::Source => "1 to 100 bytes without / + # { }",
            Self::Level => "1 to 200 bytes without / + #",
            Self::Link => "1 to 64 letters, digits, - _ and .",
            Self::Prefixes => "at most 128 letters, digits, / - _ and .",
            Self::File => "path relative to this file",
            Self::Web => "\"http://host/path\" or \"https://host/path\"",
            Self::Any(words) => words,
            Self::Model => "\"persistence\", \"builtin:<name>\", or a path relative to this file",
        }
    }

    /// A regular expression of the format, if it has one.
    pub const fn pattern(self) -> Option<&'static str> {
        match self {
            Self::Name => Some("^[A-Za-z0-9_-]{1,32}$"),
            Self::Prefix => Some("^[a-z0-9_]{1,8}$"),
            Self::Root => Some("^/.{0,48}$"),
            Self::Findings => Some("^[a-z,-]*$"),
            Self::Source => Some("^[^/+#{}]{1,100}$"),
            Self::Level => Some("^[^/+#]{1,200}$"),
            Self::Link => Some("^[A-Za-z0-9_.-]{1,64}$"),
            Self::Prefixes => Some("^[A-Za-z0-9/_.-]{0,128}$"),
            Self::PlatformFile | Self::Model | Self::File => Some("^.+$"),
            Self::Web => Some("^https?://[^/ ]+"),
            Self::StateFile | Self::Voltages | Self::Cpus | Self::Columns | Self::Any(_) => None,
        }
    }

    /// True if `text` has this format.
    #[must_use]
    pub fn allows(self, text: &str) -> bool {
        let made_of = |allowed: fn(char) -> bool, most: usize| {
            !text.is_empty() && text.len() <= most && text.chars().all(allowed)
        };
        match self {
            Self::Name => {
                made_of(|letter| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_'), 32)
            }
            Self::Prefix => made_of(
                |letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_',
                8,
            ),
            Self::Root => {
                text.starts_with('/')
                    && text.len() <= 49
                    && !text.contains('\0')
                    && !text.split('/').any(|part| part == "..")
                    && text.replace("{uid}", "").chars().all(|letter| !matches!(letter, '{' | '}'))
            }
            Self::StateFile => !text.contains('\0'),
            Self::Voltages => text.is_empty() || voltages(text).is_some(),
            Self::Cpus => cpus::parse(text).is_some(),
            Self::Columns => text.split(',').all(|pair| {
                let names = pair.split_once('=');
                names.is_some_and(|(quantity, column)| !quantity.is_empty() && !column.is_empty())
            }),
            Self::Findings => {
                text.chars().all(|letter| letter.is_ascii_lowercase() || "-,".contains(letter))
            }
            Self::Source => {
                made_of(|letter| !letter.is_control() && !"/+#{}".contains(letter), 100)
            }
            Self::Level => made_of(|letter| !letter.is_control() && !"/+#".contains(letter), 200),
            Self::Link => {
                made_of(|letter| letter.is_ascii_alphanumeric() || "-_.".contains(letter), 64)
            }
            Self::Prefixes => {
                text.is_empty()
                    || made_of(
                        |letter| letter.is_ascii_alphanumeric() || "/-_.".contains(letter),
                        128,
                    )
            }
            Self::PlatformFile | Self::Model | Self::File => {
                !text.is_empty() && !text.contains('\0')
            }
            Self::Web => {
                let rest = text.strip_prefix("http://").or_else(|| text.strip_prefix("https://"));
                rest.is_some_and(|rest| !rest.is_empty() && !rest.starts_with(['/', ' ']))
            }
            Self::Any(_) => true,
        }
    }
}
