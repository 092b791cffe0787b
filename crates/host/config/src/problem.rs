//! Problems of a config, with their location.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

/// Problems that are listed: a text of many wrong keys is no config.
pub(crate) const MAX_PROBLEMS: usize = 100;
/// Maximum length of a problem's description, letters, because it may quote a file of any length.
const MAX_SHOWN: usize = 400;

/// An error or a warning about a config file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The file, as named by the user.
    pub file: String,
    /// The line, from 1; `None` if something is missing from the whole file.
    pub line: Option<usize>,
    /// The key, with its sections; empty if the text is not TOML.
    pub key: String,
    /// The found and the allowed value.
    pub what: String,
    /// The remedy.
    pub remedy: String,
}

impl Problem {
    /// Adds a problem of `key` in `text`, the contents of `file`. It is at byte `at`, or else in
    /// the line that sets the last part of the key, if there is one. The middle of a `what` of more
    /// than 400 letters is left out. After a hundred problems only a note that there are more is
    /// added.
    pub fn add(
        problems: &mut Vec<Self>,
        (file, text): (&str, &str),
        at: Option<usize>,
        key: &str,
        what: String,
        remedy: &str,
    ) {
        let problem = match problems.len() {
            ..MAX_PROBLEMS => Self {
                file: file.to_owned(),
                line: line(text, at, key),
                key: key.to_owned(),
                what: shortened(what),
                remedy: remedy.to_owned(),
            },
            MAX_PROBLEMS => Self::more(file, None),
            _ => return,
        };
        problems.push(problem);
    }

    /// The note that follows the last listed problem.
    pub(crate) fn more(file: &str, line: Option<usize>) -> Self {
        Self {
            file: file.to_owned(),
            line,
            key: String::new(),
            what: format!("there are more than {MAX_PROBLEMS} problems"),
            remedy: "Correct those listed; the others were not looked for".to_owned(),
        }
    }
}

/// The line of byte `at`, or else the one that sets the last part of the key, if one does.
fn line(text: &str, at: Option<usize>, key: &str) -> Option<usize> {
    if let Some(at) = at {
        let before = &text.as_bytes()[..at.min(text.len())];
        return Some(1 + before.iter().filter(|byte| **byte == b'\n').count());
    }
    let name = key.rsplit('.').next().unwrap_or(key);
    let sets = |line: &str| {
        let line = line.trim_start();
        let rest = line.strip_prefix(name).filter(|_| !name.is_empty());
        rest.is_some_and(|rest| rest.trim_start().starts_with('='))
            || (!name.is_empty() && line.starts_with(&format!("[{name}]")))
    };
    text.lines().position(sets).map(|line| line + 1)
}

/// Start and end of a long text. The quoted part is in the middle.
fn shortened(text: String) -> String {
    let letters = text.chars().count();
    if letters <= MAX_SHOWN {
        return text;
    }
    let part = MAX_SHOWN / 2;
    let head: String = text.chars().take(part).collect();
    let tail: String = text.chars().skip(letters - part).collect();
    format!("{head}…{tail}")
}

impl fmt::Display for Problem {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(out, "{}:{line}: ", self.file)?,
            None => write!(out, "{}: ", self.file)?,
        }
        if !self.key.is_empty() {
            write!(out, "`{}` ", self.key)?;
        }
        write!(out, "{}. {}", self.what, self.remedy)
    }
}

/// Errors of reading a config.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file of the fleet could not be read.
    #[error("cannot read the config {}: {source}. Name an existing file with --config", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The config is refused.
    #[error("{}", listed(.0))]
    Refused(
        /// All problems; at least one.
        Vec<Problem>,
    ),
}

impl ConfigError {
    /// All problems; empty if the file could not be read.
    #[must_use]
    pub fn problems(&self) -> &[Problem] {
        match self {
            Self::Read { .. } => &[],
            Self::Refused(problems) => problems,
        }
    }
}

fn listed(problems: &[Problem]) -> String {
    let lines: Vec<String> = problems.iter().map(Problem::to_string).collect();
    lines.join("\n")
}
