//! What is wrong with a config, and where.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

/// One thing wrong (or doubtful) in a config file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The file, as it was named.
    pub file: String,
    /// The line, from 1; none where something is missing from the whole file.
    pub line: Option<usize>,
    /// The key, with its sections; empty where the text is no TOML.
    pub key: String,
    /// What was found, and what is allowed.
    pub what: String,
    /// What to do.
    pub remedy: String,
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

/// Why a config was not taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file of the fleet could not be read.
    #[error("cannot read the config {}: {source}. Name an existing file with --config", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The config was read, and refused.
    #[error("{}", listed(.0))]
    Refused(
        /// Everything that is wrong with it; at least one.
        Vec<Problem>,
    ),
}

impl ConfigError {
    /// What is wrong, one by one; empty where the file could not be read at all.
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
