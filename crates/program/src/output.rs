//! Output to stdout and stderr. Neither panics when the reader has closed it.

use std::fmt::Display;
use std::io::{self, Write as _};

use anyhow::Context as _;
use serde::Serialize;

/// The reader has closed stdout, so the program can stop.
#[derive(Debug, thiserror::Error)]
#[error("stdout was closed")]
pub struct StdoutClosed;

/// Output format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Text
    Text,
    /// JSON; unknown numbers are null
    Json,
}

/// Value of `--format`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum OutputFormat {
    /// Text
    Text,
    /// JSON; unknown numbers are null
    Json,
    /// JSON, one object per line (`cat`)
    Ndjson,
    /// A CSV table (`cat`)
    Csv,
}

/// Writes results to stdout.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    asked: OutputFormat,
}

impl Output {
    /// With the requested format.
    #[must_use]
    pub const fn new(asked: OutputFormat) -> Self {
        Self { asked }
    }

    /// The requested format, for verbs with more than two formats.
    #[must_use]
    pub const fn asked(self) -> OutputFormat {
        self.asked
    }

    /// Text or JSON.
    #[must_use]
    pub const fn format(self) -> Format {
        match self.asked {
            OutputFormat::Text => Format::Text,
            OutputFormat::Json | OutputFormat::Ndjson | OutputFormat::Csv => Format::Json,
        }
    }

    /// Writes a report: as text or as indented JSON.
    ///
    /// # Errors
    /// [`StdoutClosed`], or the operating system's error.
    pub fn report<R: Serialize + Display>(self, report: &R) -> anyhow::Result<()> {
        match self.format() {
            Format::Text => text(&report.to_string()),
            Format::Json => {
                let json = serde_json::to_string_pretty(report).context("cannot write as JSON")?;
                text(&json)
            }
        }
    }

    /// Writes a line of a stream of reports: as text or as JSON in one line.
    ///
    /// # Errors
    /// [`StdoutClosed`], or the operating system's error.
    pub fn line<R: Serialize + Display>(self, report: &R) -> anyhow::Result<()> {
        match self.format() {
            Format::Text => text(&report.to_string()),
            Format::Json => text(&serde_json::to_string(report).context("cannot write as JSON")?),
        }
    }
}

/// Writes text to stdout, followed by a newline.
///
/// # Errors
/// [`StdoutClosed`], or the operating system's error.
pub fn text(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    let line_break = if text.ends_with('\n') { "" } else { "\n" };
    let written = write!(stdout, "{text}{line_break}").and_then(|()| stdout.flush());
    match written {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(StdoutClosed.into()),
        written => written.context("cannot write to stdout"),
    }
}

/// Writes a line to stderr; errors are ignored, because it is not a result.
pub fn say(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}
