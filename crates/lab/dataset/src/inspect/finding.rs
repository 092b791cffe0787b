//! Kinds of findings and their locations.

use std::fmt;
use std::path::PathBuf;

use joulebus_plausibility::Kind;
use serde::Serialize;

/// Kind of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum FindingKind {
    /// A file that is not a recording.
    Unreadable,
    /// Same rows as another file.
    Copy,
    /// A row at the same time as the latest row before it.
    TimeRepeated,
    /// A row earlier than the latest row before it.
    TimeBackward,
    /// A step longer than 1.5 median steps.
    Gap,
    /// A row without a power reading.
    MissingReading,
    /// A row without a value in a column that has values in other rows.
    MissingValue,
    /// A value outside the plausible range.
    OutOfRange,
    /// Power differs from voltage times current.
    PowerMismatch,
    /// Power or current with the other sign.
    Sign,
    /// Magnitudes that suggest another unit.
    Unit,
    /// Times that stand still or go back in many rows.
    Clock,
    /// A command that applies long after its controller fell silent.
    Hold,
    /// A mapped column without any value.
    NeverCame,
    /// A monitor at the end of its range, or one that wraps.
    Saturation,
    /// Readings that never change.
    Constant,
    /// A number that stands for no reading.
    Sentinel,
    /// Readings of two sources in turn.
    Sources,
    /// A reading that is held far longer than usual.
    Stuck,
    /// No final newline: the file may be truncated.
    CutOff,
    /// A line that is no whole row: cut, of NUL bytes, a comment, a second header, units.
    NoRow,
    /// Rows without a robot name, while others have one.
    UnnamedRow,
    /// An unknown column.
    UnknownColumn,
    /// A column that is missing or has no value.
    MissingColumn,
    /// A constant column.
    ConstantColumn,
    /// Readings equal to the previous one.
    Held,
    /// A form of text that is not usual.
    Understood,
    /// Readings on the charger.
    OnCharger,
}

impl FindingKind {
    /// The finding of a judgement. Values out of range, and power that is not voltage times
    /// current, have places of their own.
    pub(super) const fn judged(kind: Kind) -> Option<Self> {
        match kind {
            Kind::Sign => Some(Self::Sign),
            Kind::Unit => Some(Self::Unit),
            Kind::Clock => Some(Self::Clock),
            Kind::Hold => Some(Self::Hold),
            Kind::NeverCame => Some(Self::NeverCame),
            Kind::Saturation => Some(Self::Saturation),
            Kind::Constant => Some(Self::Constant),
            Kind::Sentinel => Some(Self::Sentinel),
            Kind::Sources => Some(Self::Sources),
            _ => None,
        }
    }

    /// True if `--accept` with this kind lets it through.
    pub(super) fn is_of(self, kind: Kind) -> bool {
        let has_places = matches!(
            (kind, self),
            (Kind::Range, Self::OutOfRange) | (Kind::Mismatch, Self::PowerMismatch)
        );
        has_places || Self::judged(kind) == Some(self)
    }

    /// True if it is a fault, to be resolved before the recording is used. Other findings are
    /// informative.
    pub const fn is_fault(self) -> bool {
        !matches!(
            self,
            Self::UnknownColumn
                | Self::MissingColumn
                | Self::ConstantColumn
                | Self::Held
                | Self::Understood
                | Self::OnCharger
        )
    }
}

impl fmt::Display for FindingKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Unreadable => "files that are not recordings",
            Self::Copy => "recordings that duplicate another one",
            Self::TimeRepeated => "rows with a repeated time",
            Self::TimeBackward => "rows whose time goes back",
            Self::Gap => "gaps",
            Self::MissingReading => "rows without a power reading",
            Self::MissingValue => "missing values in recorded columns",
            Self::OutOfRange => "values out of range",
            Self::PowerMismatch => "rows whose power differs from voltage times current",
            Self::Sign => "columns that seem to have the other sign",
            Self::Clock => "clocks that stand still or go back",
            Self::Hold => "commands that never end",
            Self::NeverCame => "mapped columns without any value",
            Self::Saturation => "monitors at the end of their range",
            Self::Constant => "readings that never change",
            Self::Sentinel => "numbers that stand for no reading",
            Self::Sources => "recordings of several sources in turn",
            Self::Unit => "columns that seem to be in another unit",
            Self::Stuck => "readings held too long",
            Self::CutOff => "files that may be truncated",
            Self::NoRow => "lines that are no whole rows",
            Self::Understood => "forms of text that were recognised",
            Self::OnCharger => "readings on the charger",
            Self::UnnamedRow => "rows without a robot name",
            Self::UnknownColumn => "unknown columns",
            Self::MissingColumn => "columns that are not recorded",
            Self::ConstantColumn => "constant columns",
            Self::Held => "held readings",
        })
    }
}

/// Location and detail of a finding.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Occurrence {
    /// The file.
    pub file: PathBuf,
    /// The row in the file, from 1. Of a CSV it is the line. `None` if it concerns no single row.
    pub row: Option<usize>,
    /// The column's name in a file.
    pub column: Option<String>,
    /// Detail.
    pub what: String,
}

impl fmt::Display for Occurrence {
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

/// All findings of a kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The kind.
    pub kind: FindingKind,
    /// True if it is a fault.
    pub fault: bool,
    /// True if the user lets it through, so that it is no fault.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub accepted: bool,
    /// Number of occurrences.
    pub count: usize,
    /// Number of files with an occurrence.
    pub files: usize,
    /// The first occurrences.
    pub places: Vec<Occurrence>,
}

impl Finding {
    pub(super) const fn new(kind: FindingKind) -> Self {
        Self {
            kind,
            fault: kind.is_fault(),
            accepted: false,
            count: 0,
            files: 0,
            places: Vec::new(),
        }
    }
}
