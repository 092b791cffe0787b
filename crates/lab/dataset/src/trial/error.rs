//! Errors of reading a trial.

use std::path::{Path, PathBuf};
use std::{fmt, io};

/// Remedy for a file with bad lines: without them, or without the file.
const LEAVE_OUT: &str = ". `joulebus data convert --whole-rows` leaves such \
    lines out, or leave the file out: move it, or name the others";

/// What is wrong with a file that could not be read as a trial, or written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages of the errors say it")]
pub enum Fault {
    Io,
    Empty,
    Kind,
    Truncated,
    Gzip,
    TooManyRows,
    TooLong,
    Expands,
    RowTooLong,
    NpyHeader,
    ObjectArray,
    ElementType,
    Shape,
    TrailingBytes,
    NoHeader,
    Line,
    MissingColumns,
    Capture,
    Changed,
    DuplicateColumn,
    SpeedOrVoltage,
    FieldCount,
    Value,
    SecondRobot,
    TooManyRobots,
    NoPeriod,
    Ending,
    RobotName,
    TooFewRows,
    NoSuchColumns,
}

/// Reason that a trial could not be read or written.
#[derive(Debug)]
pub struct TrialError {
    path: PathBuf,
    fault: Fault,
    /// Row, from 1: the line of a CSV.
    row: Option<usize>,
    what: String,
    /// The allowed values, or the remedy.
    rest: String,
    source: Option<io::Error>,
}

impl TrialError {
    /// The error of a file, with what was found, what is allowed and the remedy.
    pub fn new(path: &Path, fault: Fault, what: impl Into<String>) -> Self {
        let (path, what, rest) = (path.to_owned(), what.into(), String::new());
        Self { path, fault, row: None, what, rest, source: None }
    }

    pub(super) fn in_row(self, row: usize) -> Self {
        let rest = if self.is_of_lines() { LEAVE_OUT } else { "" };
        Self { row: Some(row), rest: rest.to_owned(), ..self }
    }

    /// The same with the allowed values, or the remedy.
    pub(super) fn with(self, rest: String) -> Self {
        Self { rest, ..self }
    }

    /// The same of another path, such as the one that a file gets when it is whole.
    #[must_use]
    pub fn at(self, path: &Path) -> Self {
        Self { path: path.to_owned(), ..self }
    }

    /// Makes the error of a failed operation on a file.
    pub fn io(path: &Path) -> impl Fn(io::Error) -> Self + Copy {
        move |source| Self { source: Some(source), ..Self::new(path, Fault::Io, String::new()) }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is wrong with it.
    pub const fn fault(&self) -> Fault {
        self.fault
    }

    /// The operating system's error, if it is one.
    pub const fn os_error(&self) -> Option<&io::Error> {
        self.source.as_ref()
    }

    /// True if it concerns lines of a CSV, which can be left out.
    pub(crate) const fn is_of_lines(&self) -> bool {
        matches!(self.fault, Fault::Line | Fault::FieldCount | Fault::Value | Fault::Truncated)
    }

    /// The fault of the line, without file and remedy.
    pub(super) fn of_the_line(&self) -> String {
        match self.row {
            Some(_) => self.what.clone(),
            None => self.to_string(),
        }
    }
}

impl fmt::Display for TrialError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, fault, row, what, rest, source } = self;
        write!(out, "{}: ", path.display())?;
        if let Some(source) = source {
            return source.fmt(out);
        }
        if let Some(row) = row {
            let end = if *fault == Fault::Value { "," } else { ":" };
            write!(out, "row {row}{end} ")?;
        }
        write!(out, "{what}{rest}")
    }
}

impl std::error::Error for TrialError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.source.as_ref().map(|source| source as _)
    }
}
