//! Reads a trial from a Parquet file. Anybody may have written it.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use parquet::basic::Compression;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::DataType;
use parquet::errors::ParquetError;
use parquet::file::metadata::{FileMetaData, RowGroupMetaData};
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::schema::printer::print_schema;
use parquet::schema::types::Type;

use super::head::Head;
use super::quiet::caught;
use super::schema::{Field, HEAD_KEY, Kind, SCHEMA, SCHEMA_KEY, SUM_KEY, fields, schema};
use super::sum::{Sum, beginning};
use crate::trial::{Cell, Column, MAX_ROWS, Table, TrialError};

/// The first bytes of a Parquet file.
pub(crate) const MAGIC: &[u8] = b"PAR1";

/// Largest file that is read: [`MAX_ROWS`] rows have less.
const MAX_BYTES: u64 = 1 << 30;

/// Maximum length of a schema's line in messages, characters.
const MAX_SHOWN: usize = 100;

/// Reason that a file is refused, with the found and the allowed value.
struct Refused(String);

impl From<ParquetError> for Refused {
    fn from(error: ParquetError) -> Self {
        Self(format!("damaged or no Parquet file: {error}. Export the recording again"))
    }
}

impl From<io::Error> for Refused {
    fn from(error: io::Error) -> Self {
        Self(error.to_string())
    }
}

/// The trial of a file, with its metadata.
pub(crate) fn table(path: &Path) -> Result<(Table, Head), TrialError> {
    let file = joulebus_files::open(path).map_err(TrialError::io(path))?;
    let refused = |Refused(detail)| TrialError::Archive { path: path.to_owned(), detail };
    // The decoders of the crate check their input, but promise nothing for hostile input.
    let read = caught(|| columns(file));
    let (head, columns) = match read {
        Some(read) => read.map_err(refused)?,
        None => {
            let detail = "damaged: its pages contradict each other. Export the recording again";
            return Err(refused(Refused(detail.to_owned())));
        }
    };
    let table = assemble(path, &head, columns)?;
    Ok((table, head))
}

/// Values of the columns that make up a trial.
#[derive(Default)]
struct Values {
    row: Vec<u32>,
    timestamp_s: Vec<f64>,
    /// Flags of samples, 0 where the recording has none.
    flags: Vec<u32>,
    /// The columns in the order of [`Column::ALL`], NaN for missing values.
    of_trial: [Vec<f64>; Column::ALL.len()],
}

fn columns(file: File) -> Result<(Head, Values), Refused> {
    let found_bytes = file.metadata().map_or(u64::MAX, |about| about.len());
    if found_bytes > MAX_BYTES {
        return Err(Refused(format!(
            "found {found_bytes} bytes, allowed are {MAX_BYTES}, more than the longest trial has"
        )));
    }
    let rows_of = file.try_clone()?;
    let reader = SerializedFileReader::new(file)?;
    let about = reader.metadata().file_metadata();
    let head = head(about)?;
    check_sum(&rows_of, about)?;
    let fields = fields();
    let mut values = Values::default();
    for group in 0..reader.num_row_groups() {
        let about = reader.metadata().row_group(group);
        let rows = rows(about, values.row.len())?;
        let group = reader.get_row_group(group)?;
        for (at, field) in fields.iter().enumerate() {
            read_column(group.as_ref(), at, field, rows, &mut values)?;
        }
    }
    Ok((head, values))
}

/// The footer's value of a key.
fn value<'a>(about: &'a FileMetaData, key: &str) -> Option<&'a str> {
    let mut all = about.key_value_metadata()?.iter();
    let found = all.rfind(|pair| pair.key == key)?;
    found.value.as_deref()
}

/// Refuses rows that are not as they were written: a damaged number is a number.
fn check_sum(file: &File, about: &FileMetaData) -> Result<(), Refused> {
    let Some(stated) = value(about, SUM_KEY).and_then(Sum::parse) else {
        return Err(Refused(format!(
            "damaged: no {SUM_KEY} in its footer. Export the recording again"
        )));
    };
    let (bytes, crc) = beginning(file, stated.bytes)?;
    let found = Sum::new(bytes, crc, value(about, HEAD_KEY).unwrap_or_default());
    if found == stated {
        return Ok(());
    }
    Err(Refused(format!(
        "damaged: its rows are {found} (bytes, CRC-32), {stated} were written. Copy it again, or \
            export the recording \
         again"
    )))
}

/// The metadata in the footer of a file with the columns of this version.
fn head(about: &FileMetaData) -> Result<Head, Refused> {
    let value = |key| value(about, key);
    let remedy = "allowed are files that `joulebus export` wrote. Write others as CSV";
    match value(SCHEMA_KEY) {
        None => {
            return Err(Refused(format!("a Parquet file of another program, {remedy}")));
        }
        Some(found) if found != SCHEMA.to_string() => {
            return Err(Refused(format!(
                "has schema {found:?}, allowed is {SCHEMA}. Export the recording again with this \
                    release"
            )));
        }
        Some(_) => {}
    }
    let allowed = schema()?;
    if about.schema() != allowed.as_ref() {
        let differs = difference(about.schema(), &allowed);
        return Err(Refused(format!(
            "states schema {SCHEMA}, but has other columns or types: {differs}. Another program \
                has written it since: {remedy}"
        )));
    }
    let text = value(HEAD_KEY).unwrap_or_default();
    let head: Head = serde_json::from_str(text)
        .map_err(|error| Refused(format!("{HEAD_KEY} in its footer: {error}, {remedy}")))?;
    let is_known = |name: &String| Column::ALL.iter().any(|column| column.name() == name);
    match head.columns.iter().find(|name| !is_known(name)) {
        None => Ok(head),
        Some(name) => Err(Refused(format!(
            "{HEAD_KEY} in its footer: no column is called {name:?}, {remedy}"
        ))),
    }
}

/// The first column that is not as it should be.
fn difference(found: &Type, allowed: &Type) -> String {
    let lines = |of: &Type| {
        let mut text = Vec::new();
        print_schema(&mut text, of);
        String::from_utf8_lossy(&text).into_owned()
    };
    let (found, allowed) = (lines(found), lines(allowed));
    // The first line has the name of the whole.
    let found = found.lines().skip(1).chain(std::iter::repeat("}"));
    let mut pairs = found.zip(allowed.lines().skip(1));
    let shown = |line: &str| match line {
        "}" => "no further column".to_owned(),
        line => line.trim().trim_end_matches(';').chars().take(MAX_SHOWN).collect(),
    };
    match pairs.find(|(found, allowed)| found != allowed) {
        Some((found, allowed)) => format!("found {}, allowed is {}", shown(found), shown(allowed)),
        None => "found another name or numbers of the columns".to_owned(),
    }
}

/// Number of rows of a row group, which must be the same for all columns.
fn rows(about: &RowGroupMetaData, before: usize) -> Result<usize, Refused> {
    let stated = about.num_rows();
    let rows = usize::try_from(stated).ok();
    let rows = rows.filter(|rows| *rows <= MAX_ROWS.saturating_sub(before));
    let Some(rows) = rows else {
        return Err(Refused(format!(
            "states {stated} rows in a row group, allowed are {MAX_ROWS} in the whole file: split \
                the recording"
        )));
    };
    for column in about.columns() {
        let (name, values) = (column.column_path().string(), column.num_values());
        if values != stated {
            return Err(Refused(format!(
                "{name}: {values} values in a row group of {stated} rows. Export the recording \
                    again"
            )));
        }
        // The crate takes these for granted.
        let first = column.dictionary_page_offset();
        let first = first.unwrap_or(column.data_page_offset());
        if first < 0 || column.data_page_offset() < 0 || column.compressed_size() < 0 {
            return Err(Refused(format!(
                "{name}: states {} bytes from {first} on, allowed are no negative numbers: export \
                    the recording again",
                column.compressed_size()
            )));
        }
        let found = column.compression();
        if found != Compression::UNCOMPRESSED {
            return Err(Refused(format!(
                "{name}: compressed by {found}, allowed is none, as `joulebus export` writes it"
            )));
        }
    }
    Ok(rows)
}

fn read_column(
    group: &dyn RowGroupReader,
    at: usize,
    field: &Field,
    rows: usize,
    values: &mut Values,
) -> Result<(), Refused> {
    match (group.get_column_reader(at)?, field.kind, field.column) {
        (ColumnReader::DoubleColumnReader(reader), Kind::F64, None) => {
            let mut found = column_values(reader, field, rows, f64::NAN)?;
            values.timestamp_s.append(&mut found);
        }
        (ColumnReader::DoubleColumnReader(reader), Kind::F64, Some(column)) => {
            let mut found = column_values(reader, field, rows, f64::NAN)?;
            values.of_trial[column as usize].append(&mut found);
        }
        (ColumnReader::Int32ColumnReader(reader), Kind::U32, None) if field.name == "row" => {
            let found = column_values(reader, field, rows, 0)?;
            values.row.extend(found.into_iter().map(i32::cast_unsigned));
        }
        (ColumnReader::Int32ColumnReader(reader), Kind::U32, None) if field.name == "flags" => {
            let found = column_values(reader, field, rows, 0)?;
            values.flags.extend(found.into_iter().map(i32::cast_unsigned));
        }
        // Exact integers are for other programs.
        _ => {}
    }
    Ok(())
}

/// One value for each row, `missing` for null.
fn column_values<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    field: &Field,
    rows: usize,
    missing: T::T,
) -> Result<Vec<T::T>, Refused>
where
    T::T: Copy,
{
    let (mut known, mut levels) = (Vec::new(), Vec::new());
    let mut found = 0;
    while found < rows {
        let wanted = field.is_nullable.then_some(&mut levels);
        let (records, _, _) = reader.read_records(rows - found, wanted, None, &mut known)?;
        if records == 0 {
            let name = field.name;
            return Err(Refused(format!(
                "{name}: {found} values in a row group of {rows} rows. Export the recording again"
            )));
        }
        found += records;
    }
    if !field.is_nullable {
        return Ok(known);
    }
    let mut known = known.into_iter();
    let each = levels.into_iter().map(|level| match level {
        0 => Some(missing),
        _ => known.next(),
    });
    let each: Option<Vec<T::T>> = each.collect();
    each.ok_or_else(|| {
        let name = field.name;
        Refused(format!("{name}: fewer values than it states. Export the recording again"))
    })
}

/// The trial under the name of its recording. A value that no recording can have is refused as
/// there.
fn assemble(path: &Path, head: &Head, values: Values) -> Result<Table, TrialError> {
    let mut table = Table {
        path: path.to_owned(),
        robot_name: head.robot.clone(),
        ignored_columns: head.ignored_columns.clone(),
        no_final_line_break: head.no_final_line_break,
        unnamed_rows: head.unnamed_rows,
        sources: head.sources.clone(),
        time_name: head.time_name.clone(),
        states_time_unit: head.states_time_unit,
        left_out: head.left_out.clone(),
        understood: head.understood.clone(),
        is_turned: false,
        ..Table::default()
    };
    let Values { row, timestamp_s, flags, of_trial } = values;
    for (row, time_s) in row.iter().zip(timestamp_s) {
        let row = *row as usize;
        table.push_time(Cell { path, row }, time_s)?;
    }
    for (column, values) in Column::ALL.into_iter().zip(of_trial) {
        let is_stated = head.columns.iter().any(|name| name == column.name());
        if !is_stated || table.rows() == 0 {
            continue;
        }
        for (row, value) in row.iter().zip(values) {
            let row = *row as usize;
            table.push(Cell { path, row }, column, value)?;
        }
    }
    table.leave_out_charging(flags);
    table.path = PathBuf::from(&head.recording);
    Ok(table)
}
