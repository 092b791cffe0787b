//! Kinds of findings and their locations.

use std::fmt;
use std::path::PathBuf;

use joulebus_plausibility::Kind;
use serde::Serialize;

/// Kind of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
#[expect(missing_docs, reason = "their names and texts say it")]
pub enum FindingKind {
    Unreadable,
    Copy,
    TimeRepeated,
    TimeBackward,
    Gap,
    MissingReading,
    MissingValue,
    OutOfRange,
    PowerMismatch,
    Sign,
    Unit,
    Clock,
    Hold,
    NeverCame,
    Saturation,
    Constant,
    Sentinel,
    Sources,
    Stuck,
    CutOff,
    NoRow,
    UnnamedRow,
    UnknownColumn,
    MissingColumn,
    ConstantColumn,
    Held,
    Understood,
    OnCharger,
}

/// In the order of [`FindingKind`]: the kind of the judgement, whose finding it may be, whether it
/// is a fault, and what it is.
const KINDS: [(Option<Kind>, bool, &str); 28] = [
    (None, true, "files that are not recordings"),
    (None, true, "recordings that duplicate another one"),
    (None, true, "rows with a repeated time"),
    (None, true, "rows whose time goes back"),
    (None, true, "gaps"),
    (None, true, "rows without a power reading"),
    (None, true, "missing values in recorded columns"),
    (Some(Kind::Range), true, "values out of range"),
    (Some(Kind::Mismatch), true, "rows whose power differs from voltage times current"),
    (Some(Kind::Sign), true, "columns that seem to have the other sign"),
    (Some(Kind::Unit), true, "columns that seem to be in another unit"),
    (Some(Kind::Clock), true, "clocks that stand still or go back"),
    (Some(Kind::Hold), true, "commands that never end"),
    (Some(Kind::NeverCame), true, "mapped columns without any value"),
    (Some(Kind::Saturation), true, "monitors at the end of their range"),
    (Some(Kind::Constant), true, "readings that never change"),
    (Some(Kind::Sentinel), true, "numbers that stand for no reading"),
    (Some(Kind::Sources), true, "recordings of several sources in turn"),
    (None, true, "readings held too long"),
    (None, true, "files that may be truncated"),
    (None, true, "lines that are no whole rows"),
    (None, true, "rows without a robot name"),
    (None, false, "unknown columns"),
    (None, false, "columns that are not recorded"),
    (None, false, "constant columns"),
    (None, false, "held readings"),
    (None, false, "forms of text that were recognised"),
    (None, false, "readings on the charger"),
];

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
        KINDS[self as usize].0 == Some(kind)
    }

    /// True if it is a fault, to be resolved before the recording is used. Other findings are
    /// informative.
    pub const fn is_fault(self) -> bool {
        KINDS[self as usize].1
    }
}

impl fmt::Display for FindingKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(KINDS[*self as usize].2)
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
