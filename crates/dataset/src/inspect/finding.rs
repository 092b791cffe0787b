//! What can be said about a recording, and where.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum FindingKind {
    /// A file that is no recording.
    Unreadable,
    /// The rows of another file again.
    Copy,
    /// A row at the time of the latest row before.
    TimeRepeated,
    /// A row earlier than the latest row before.
    TimeBackward,
    /// A step of more than 1.5 median ones.
    Gap,
    /// A row without a power reading.
    MissingReading,
    /// A row without a value in a column that others have one in.
    MissingValue,
    /// A value past what can be true.
    OutOfRange,
    /// Power that is not voltage times current.
    PowerMismatch,
    /// Numbers that look like another unit.
    Unit,
    /// A reading that stands far longer than readings usually do.
    Stuck,
    /// A last line without a line break: it may have been cut off.
    CutOff,
    /// Rows without the robot's name, while others have it.
    UnnamedRow,
    /// A column that has no meaning here.
    UnknownColumn,
    /// A column that is not there, or has no value.
    MissingColumn,
    /// A column with one value only.
    ConstantColumn,
    /// Readings that repeat the one before.
    Held,
}

impl FindingKind {
    /// Whether it is a fault: something that a researcher has to know before the recording is used.
    /// The rest is how the recording is.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        !matches!(
            self,
            Self::UnknownColumn | Self::MissingColumn | Self::ConstantColumn | Self::Held
        )
    }
}

impl fmt::Display for FindingKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Unreadable => "files that are no recordings",
            Self::Copy => "recordings that are another one again",
            Self::TimeRepeated => "rows at the time of the row before",
            Self::TimeBackward => "rows earlier than one before",
            Self::Gap => "gaps",
            Self::MissingReading => "rows without a power reading",
            Self::MissingValue => "values missing in columns that have some",
            Self::OutOfRange => "values that cannot be true",
            Self::PowerMismatch => "rows whose power is not voltage times current",
            Self::Unit => "columns that look like another unit",
            Self::Stuck => "readings that stand too long",
            Self::CutOff => "files that may be cut off",
            Self::UnnamedRow => "rows without the robot's name",
            Self::UnknownColumn => "columns without a meaning here",
            Self::MissingColumn => "columns that are not recorded",
            Self::ConstantColumn => "columns that never change",
            Self::Held => "readings that repeat the one before",
        })
    }
}

/// Where something was found, and what.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Place {
    /// The file.
    pub file: PathBuf,
    /// The row in the file, from 1, a CSV's header not included; none for what is no row's.
    pub row: Option<usize>,
    /// The column's name in a file.
    pub column: Option<String>,
    /// What was found there.
    pub what: String,
}

impl fmt::Display for Place {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.file.display())?;
        if let Some(row) = self.row {
            write!(out, ": row {row}")?;
        }
        if let Some(column) = &self.column {
            write!(out, ", {column}")?;
        }
        write!(out, ": {}", self.what)
    }
}

/// All that was found of a kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// What.
    pub kind: FindingKind,
    /// Whether it is a fault.
    pub fault: bool,
    /// How often.
    pub count: usize,
    /// Files in which.
    pub files: usize,
    /// The first places.
    pub places: Vec<Place>,
}

impl Finding {
    pub(super) const fn new(kind: FindingKind) -> Self {
        Self {
            kind,
            fault: kind.is_fault(),
            count: 0,
            files: 0,
            places: Vec::new(),
        }
    }
}
