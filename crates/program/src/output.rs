//! What goes to stdout and what to stderr. Neither panics when nobody reads.

use std::fmt::Display;
use std::io::{self, Write as _};

use anyhow::Context as _;
use serde::Serialize;

/// Nobody reads stdout any more, so there is nothing left to do.
#[derive(Debug, thiserror::Error)]
#[error("stdout was closed")]
pub struct StdoutClosed;

/// How results are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// For people
    Text,
    /// For programs; not-known numbers are null
    Json,
}

/// What `--format` asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum OutputFormat {
    /// For people
    Text,
    /// For programs; not-known numbers are null
    Json,
    /// For programs, an object on each line (`cat`)
    Ndjson,
    /// A table (`cat`)
    Csv,
}

/// Writes results to stdout.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    asked: OutputFormat,
}

impl Output {
    /// In the form that was asked for.
    #[must_use]
    pub const fn new(asked: OutputFormat) -> Self {
        Self { asked }
    }

    /// What was asked for, where a verb has more forms than two.
    #[must_use]
    pub const fn asked(self) -> OutputFormat {
        self.asked
    }

    /// Whether results are for people or for programs.
    #[must_use]
    pub const fn format(self) -> Format {
        match self.asked {
            OutputFormat::Text => Format::Text,
            OutputFormat::Json | OutputFormat::Ndjson | OutputFormat::Csv => Format::Json,
        }
    }

    /// A report: as text or as JSON over several lines.
    ///
    /// # Errors
    /// [`StdoutClosed`], or what the system said.
    pub fn report<R: Serialize + Display>(self, report: &R) -> anyhow::Result<()> {
        match self.format() {
            Format::Text => text(&report.to_string()),
            Format::Json => {
                let json = serde_json::to_string_pretty(report).context("cannot write as JSON")?;
                text(&json)
            }
        }
    }

    /// A line of a stream of reports: as text or as JSON in one line.
    ///
    /// # Errors
    /// [`StdoutClosed`], or what the system said.
    pub fn line<R: Serialize + Display>(self, report: &R) -> anyhow::Result<()> {
        match self.format() {
            Format::Text => text(&report.to_string()),
            Format::Json => text(&serde_json::to_string(report).context("cannot write as JSON")?),
        }
    }
}

/// Text to stdout, ended by a line break.
///
/// # Errors
/// [`StdoutClosed`], or what the system said.
pub fn text(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    let line_break = if text.ends_with('\n') { "" } else { "\n" };
    let written = write!(stdout, "{text}{line_break}").and_then(|()| stdout.flush());
    match written {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(StdoutClosed.into()),
        written => written.context("cannot write to stdout"),
    }
}

/// A line to stderr. Not a result: if nobody reads it, nothing is lost.
pub fn say(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}
