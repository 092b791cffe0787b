//! Problems of a config, with their location.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

/// An error or a warning about a config file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The file, as named by the user.
    pub file: String,
    /// The line, from 1; `None` if something is missing from the whole file.
    pub line: Option<usize>,
    /// The key, with its sections; empty if the text is not TOML.
    pub key: String,
    /// What was found, and what is allowed.
    pub what: String,
    /// What to do.
    pub remedy: String,
}

impl Problem {
    /// A problem of `key` in `text`, the contents of `file`: at byte `at`, or else in the line that sets the last part of
    /// the key, if one does.
    #[must_use]
    pub fn in_text(
        (file, text): (&str, &str),
        at: Option<usize>,
        key: &str,
        what: String,
        remedy: &str,
    ) -> Self {
        let name = key.rsplit('.').next().unwrap_or(key);
        let sets = |line: &str| {
            let line = line.trim_start();
            let rest = line.strip_prefix(name).filter(|_| !name.is_empty());
            rest.is_some_and(|rest| rest.trim_start().starts_with('='))
                || (!name.is_empty() && line.starts_with(&format!("[{name}]")))
        };
        let line = match at {
            Some(at) => {
                let before = &text.as_bytes()[..at.min(text.len())];
                Some(1 + before.iter().filter(|byte| **byte == b'\n').count())
            }
            None => text.lines().position(sets).map(|line| line + 1),
        };
        Self {
            file: file.to_owned(),
            line,
            key: key.to_owned(),
            what,
            remedy: remedy.to_owned(),
        }
    }
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
