//! Errors of reading a trial.

use std::io;
use std::path::{Path, PathBuf};

use super::limits::{FREE_TEXT_BYTES, MAX_EXPANSION, MAX_ROBOTS, MAX_ROW_BYTES, MAX_TEXT_BYTES};

/// Remedy for a file with bad lines: without them, or without the file.
const LEAVE_OUT: &str = "--whole-rows leaves such lines out (`joulebus data convert --whole-rows` for other programs), or leave the \
                         file out: move it, or name the others";

/// Reason that a trial could not be read. Rows count from 1, those of a CSV as its lines.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrialError {
    /// The operating system could not open or read the file.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: io::Error,
    },
    /// The file is empty.
    #[error("{path}: empty, expected a .npy array or a CSV with a header", path = path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file has another format.
    #[error(
        "{path}: found {found}, expected a .npy array of shape (n, 11), a CSV, plain or .gz, or a \
            capture (.mcap)",
        path = path.display()
    )]
    Kind {
        /// The file.
        path: PathBuf,
        /// The format it seems to have, and how it is converted.
        found: String,
    },
    /// The file is truncated.
    #[error(
        "{path}: truncated: {missing} after {rows} complete rows. Copy the file again, or leave \
            it out of the command",
        path = path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// The missing data.
        missing: String,
        /// Complete rows before the end.
        rows: usize,
    },
    /// The gzip data are corrupt.
    #[error("{path}: damaged gzip data after {rows} complete rows: {detail}", path = path.display())]
    Gzip {
        /// The file.
        path: PathBuf,
        /// Complete rows before the corruption.
        rows: usize,
        /// The decoder's error.
        detail: String,
    },
    /// Too many rows.
    #[error(
        "{path}: more than {allowed} rows, which this verb has in memory at the same time. Split \
            the recording (`data check`, \
         `train`, `eval`, `analyze` and `config init` read it in parts)",
        path = path.display()
    )]
    TooManyRows {
        /// The file.
        path: PathBuf,
        /// Allowed rows.
        allowed: usize,
    },
    /// Too much text.
    #[error(
        "{path}: more than {MAX_TEXT_BYTES} bytes of text. Split the recording",
        path = path.display()
    )]
    TooLong {
        /// The file.
        path: PathBuf,
    },
    /// Too much text for the size of the compressed file.
    #[error(
        "{path}: more than {allowed} bytes of text in {found} bytes of gzip, allowed are \
            {MAX_EXPANSION} \
         for each, and {FREE_TEXT_BYTES} in any case. Decompress it first",
        path = path.display()
    )]
    Expands {
        /// The file.
        path: PathBuf,
        /// Bytes of the file.
        found: u64,
        /// Allowed bytes of text.
        allowed: u64,
    },
    /// A row is too long.
    #[error(
        "{path}: more than {MAX_ROW_BYTES} bytes in the row after {rows} whole rows",
        path = path.display()
    )]
    RowTooLong {
        /// The file.
        path: PathBuf,
        /// Complete rows before it.
        rows: usize,
    },
    /// The header of the array is not that of a plain array.
    #[error("{path}: array header: {detail}", path = path.display())]
    NpyHeader {
        /// The file.
        path: PathBuf,
        /// The problem with the expected value.
        detail: String,
    },
    /// The array holds Python objects: reading them would execute code.
    #[error(
        "{path}: found an array of Python objects, which is never read. Save the table as a plain \
            float64 array",
        path = path.display()
    )]
    ObjectArray {
        /// The file.
        path: PathBuf,
    },
    /// The elements of the array are not floats.
    #[error("{path}: found elements of type {found}, allowed: f4 or f8", path = path.display())]
    ElementType {
        /// The file.
        path: PathBuf,
        /// The type in NumPy's notation.
        found: String,
    },
    /// The array does not have eleven columns.
    #[error("{path}: found shape ({found}), allowed: (n, 11) with n ≥ 2", path = path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// The shape.
        found: String,
    },
    /// The file is longer than its header states.
    #[error(
        "{path}: {found_bytes} bytes, but the header's {rows} rows end at {expected_bytes}. \
            Another file may have been appended",
        path = path.display()
    )]
    TrailingBytes {
        /// The file.
        path: PathBuf,
        /// Rows that the header states.
        rows: usize,
        /// Bytes in the file.
        found_bytes: u64,
        /// Bytes of header and rows.
        expected_bytes: u64,
    },
    /// The first line has no names.
    #[error(
        "{path}: the first line has no names, but {found}. Put a line with the names of the \
            columns in front, such as \
         timestamp_s,voltage_V,current_A (`ros2 topic echo --csv` writes none)",
        path = path.display()
    )]
    NoHeader {
        /// The file.
        path: PathBuf,
        /// The line.
        found: String,
    },
    /// A line is no row.
    #[error("{path}: row {row}: {what}. {LEAVE_OUT}", path = path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Row, from 1.
        row: usize,
        /// Description of the line.
        what: String,
    },
    /// Required columns are missing.
    #[error(
        "{path}: no column for {missing}, found {found}. {suggestion} (`joulebus data check --help` \
         lists the accepted names)",
        path = path.display()
    )]
    MissingColumns {
        /// The file.
        path: PathBuf,
        /// The missing columns with their accepted names.
        missing: String,
        /// The columns of the header.
        found: String,
        /// Whether the time is missing, and power.
        lacks: [bool; 2],
        /// The options that name them, tried on the first rows.
        suggestion: String,
    },
    /// A capture could not be read.
    #[error("{path}: {detail}", path = path.display())]
    Capture {
        /// The file.
        path: PathBuf,
        /// The problem with its remedy.
        detail: String,
    },
    /// A file that is read a second time has other contents than before.
    #[error(
        "{path}: changed while it was used: {found} rows, or other ones, where {before} were read \
            before. Run the command again when it is complete",
        path = path.display()
    )]
    Changed {
        /// The file.
        path: PathBuf,
        /// Rows now.
        found: usize,
        /// Rows before.
        before: usize,
    },
    /// Two columns have the same meaning.
    #[error(
        "{path}: columns {first} and {second} are synonyms. Keep one, or name it with --map",
        path = path.display()
    )]
    DuplicateColumn {
        /// The file.
        path: PathBuf,
        /// Name of the first.
        first: String,
        /// Name of the second.
        second: String,
    },
    /// A column that can be a speed or a voltage.
    #[error(
        "{path}: column {column} beside {beside} can be a speed or a voltage. Name it: \
         --map v_mps={column}, or --map voltage_V={column}",
        path = path.display()
    )]
    SpeedOrVoltage {
        /// The file.
        path: PathBuf,
        /// Its name.
        column: String,
        /// The column with the current.
        beside: String,
    },
    /// A row has more or fewer fields than the header.
    #[error(
        "{path}: row {row}: found {found} fields, the header has {expected}. {LEAVE_OUT}",
        path = path.display()
    )]
    FieldCount {
        /// The file.
        path: PathBuf,
        /// Row, from 1.
        row: usize,
        /// Fields in the row.
        found: usize,
        /// Fields in the header.
        expected: usize,
    },
    /// A value is not allowed.
    #[error(
        "{path}: row {row}, column {column}: found {found:?}, allowed: {allowed}",
        path = path.display()
    )]
    Value {
        /// The file.
        path: PathBuf,
        /// Row, from 1.
        row: usize,
        /// Name of the column.
        column: String,
        /// The value.
        found: String,
        /// Allowed values.
        allowed: String,
    },
    /// More than one robot in the file.
    #[error(
        "{path}: row {row}: robot {found:?} after robot {first:?}. A trial holds one robot: \
         `joulebus data convert` splits the file",
        path = path.display()
    )]
    SecondRobot {
        /// The file.
        path: PathBuf,
        /// Row, from 1.
        row: usize,
        /// The first robot.
        first: String,
        /// The other robot.
        found: String,
    },
    /// More robots in one file than plausible.
    #[error("{path}: more than {MAX_ROBOTS} robots. Split the recording", path = path.display())]
    TooManyRobots {
        /// The file.
        path: PathBuf,
    },
    /// No timestamp advances.
    #[error(
        "{path}: {rows} rows, and no timestamp advances. A trial needs two rows at increasing \
            times",
        path = path.display()
    )]
    NoPeriod {
        /// The file.
        path: PathBuf,
        /// Rows in the file.
        rows: usize,
    },
}

impl TrialError {
    /// Makes the error of a failed operation on a file.
    pub(crate) fn io(path: &Path) -> impl Fn(io::Error) -> Self + Copy {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    /// True if it concerns lines of a CSV, which can be left out.
    pub(crate) const fn is_of_lines(&self) -> bool {
        matches!(
            self,
            Self::Line { .. }
                | Self::FieldCount { .. }
                | Self::Value { .. }
                | Self::Truncated { .. }
        )
    }

    /// The fault of the line, without file and remedy.
    pub(super) fn of_the_line(&self) -> String {
        match self {
            Self::Line { what, .. } => what.clone(),
            Self::FieldCount { found, expected, .. } => {
                format!("found {found} fields, the header has {expected}")
            }
            Self::Value { column, found, .. } => format!("found {found:?} in column {column}"),
            other => other.to_string(),
        }
    }
}
