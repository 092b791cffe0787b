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
    /// The line, from 1. `None` if something is missing from the whole file.
    pub line: Option<usize>,
    /// The key, with its sections, or nothing if the text is not TOML.
    pub key: String,
    /// The found and the allowed value.
    pub what: String,
    /// The remedy.
    pub remedy: String,
}

impl Problem {
    /// Adds the problem to others. The middle of a `what` of more than 400 letters is left out.
    /// After a hundred problems only a note that there are more is added.
    pub fn add_to(self, problems: &mut Vec<Self>) {
        match problems.len() {
            ..MAX_PROBLEMS => problems.push(Self { what: shortened(self.what), ..self }),
            MAX_PROBLEMS => problems.push(Self {
                key: String::new(),
                what: format!("there are more than {MAX_PROBLEMS} problems"),
                remedy: "Correct those listed. The others were not looked for".to_owned(),
                ..self
            }),
            _ => {}
        }
    }
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
#[allow(missing_docs)] // The messages name the fields.
pub enum ConfigError {
    /// The file of the fleet could not be read.
    #[error("cannot read the config {}: {source}. Name an existing file with --config", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    /// The config is refused.
    #[error("{}", listed(.0))]
    Refused(
        /// All problems, at least one.
        Vec<Problem>,
    ),
}

impl ConfigError {
    /// All problems, none if the file could not be read.
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
