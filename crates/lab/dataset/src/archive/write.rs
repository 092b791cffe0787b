//! Writes a trial as a Parquet file.

use std::io::{self, Write};
use std::ops::Range;
use std::sync::Arc;

use parquet::basic::{Compression, Encoding};
use parquet::data_type::{DoubleType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};

use super::head::{Head, RowStamp};
use super::schema::{
    Field, HEAD_KEY, Kind, SCHEMA, SCHEMA_KEY, SUM_KEY, UNITS_KEY, fields, schema, units,
};
use super::sum::Sum;
use crate::trial::Table;

/// Rows of a row group: the unit that readers can skip by statistics.
const GROUP_ROWS: usize = 1 << 16;

/// Reason that a trial could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteArchiveError {
    /// The operating system's error.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// An error of the crate `parquet`, for instance a full disk.
    #[error("cannot write Parquet: {0}")]
    Parquet(String),
}

impl From<ParquetError> for WriteArchiveError {
    fn from(error: ParquetError) -> Self {
        Self::Parquet(error.to_string())
    }
}

/// The files and rows written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exported {
    /// Bytes of the file.
    pub bytes: u64,
    /// Their CRC-32.
    pub crc32: u32,
}

/// Writes the rows of a trial into `out`, a new file. `stamps` has one entry for each row of a
/// capture.
///
/// # Errors
/// [`WriteArchiveError`].
pub fn write<W: Write + Send>(
    table: &Table,
    stamps: Option<&[RowStamp]>,
    head: &Head,
    out: W,
) -> Result<Exported, WriteArchiveError> {
    let out = Summed { out, bytes: 0, crc: crc32fast::Hasher::new() };
    // A struct of text and numbers can always be written.
    let head_text = serde_json::to_string(head).unwrap_or_default();
    let properties = Arc::new(properties(&head_text));
    let mut writer = SerializedFileWriter::new(out, schema()?, properties)?;
    let fields = fields();
    let mut start = 0;
    while start < table.rows() {
        let rows = start..table.rows().min(start + GROUP_ROWS);
        let mut group = writer.next_row_group()?;
        for field in &fields {
            let Some(mut column) = group.next_column()? else {
                break;
            };
            write_column(&mut column, field, (table, stamps, head), rows.clone())?;
            column.close()?;
        }
        group.close()?;
        start = rows.end;
    }
    writer.flush()?;
    let before = writer.inner();
    let sum = Sum::new(before.bytes, before.crc.clone(), &head_text);
    writer.append_key_value_metadata(KeyValue::new(SUM_KEY.to_owned(), sum.to_string()));
    let mut out = writer.into_inner()?;
    out.flush()?;
    Ok(Exported { bytes: out.bytes, crc32: out.crc.finalize() })
}

/// Without compression: readings repeat, and whole numbers rise evenly, so encodings leave little
/// for it, and nothing in a hostile file can expand.
fn properties(head: &str) -> WriterProperties {
    let value = |key: &str, value: String| KeyValue::new(key.to_owned(), value);
    let metadata = vec![
        value(SCHEMA_KEY, SCHEMA.to_string()),
        value(UNITS_KEY, units()),
        value(HEAD_KEY, head.to_owned()),
    ];
    let mut properties = WriterProperties::builder()
        .set_created_by(concat!("joulebus ", env!("CARGO_PKG_VERSION")).to_owned())
        .set_compression(Compression::UNCOMPRESSED)
        .set_max_row_group_row_count(None)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true)
        .set_key_value_metadata(Some(metadata));
    for field in fields().iter().filter(|field| field.kind != Kind::F64) {
        properties = properties
            .set_column_dictionary_enabled(field.name.into(), false)
            .set_column_encoding(field.name.into(), Encoding::DELTA_BINARY_PACKED);
    }
    properties.build()
}

fn write_column(
    column: &mut SerializedColumnWriter<'_>,
    field: &Field,
    (table, stamps, head): (&Table, Option<&[RowStamp]>, &Head),
    rows: Range<usize>,
) -> Result<(), ParquetError> {
    if field.kind == Kind::F64 {
        let missing = |values: &Option<&[f64]>| values.is_none();
        let values = match field.column {
            Some(of_trial) => table.column(of_trial),
            None => Some(table.timestamp_s()),
        };
        if missing(&values) {
            return nulls(column, field.kind, rows.len());
        }
        let values = &values.unwrap_or_default()[rows];
        if !field.is_nullable {
            let written = column.typed::<DoubleType>();
            return written.write_batch(values, None, None).map(|_| ());
        }
        let levels: Vec<i16> = values.iter().map(|value| i16::from(!value.is_nan())).collect();
        let known: Vec<f64> = values.iter().copied().filter(|value| !value.is_nan()).collect();
        let written = column.typed::<DoubleType>();
        return written.write_batch(&known, Some(&levels), None).map(|_| ());
    }
    let numbers = rows.clone().map(|row| number(field, (table, stamps, head), row));
    let numbers: Vec<Option<u64>> = numbers.collect();
    if numbers.iter().all(Option::is_none) {
        return nulls(column, field.kind, rows.len());
    }
    let levels: Vec<i16> = numbers.iter().map(|number| i16::from(number.is_some())).collect();
    let levels = field.is_nullable.then_some(levels.as_slice());
    let known = numbers.into_iter().flatten();
    if field.kind == Kind::U32 {
        // The bits of an unsigned number, as the format stores it.
        let known: Vec<i32> = known.map(|number| (number as u32).cast_signed()).collect();
        let written = column.typed::<Int32Type>();
        return written.write_batch(&known, levels, None).map(|_| ());
    }
    let known: Vec<i64> = known.map(u64::cast_signed).collect();
    let written = column.typed::<Int64Type>();
    written.write_batch(&known, levels, None).map(|_| ())
}

/// A column without values.
fn nulls(
    column: &mut SerializedColumnWriter<'_>,
    kind: Kind,
    rows: usize,
) -> Result<(), ParquetError> {
    let levels = vec![0_i16; rows];
    let levels = Some(levels.as_slice());
    let written = match kind {
        Kind::F64 => column.typed::<DoubleType>().write_batch(&[], levels, None)?,
        Kind::U32 => column.typed::<Int32Type>().write_batch(&[], levels, None)?,
        Kind::U64 | Kind::I64 => column.typed::<Int64Type>().write_batch(&[], levels, None)?,
    };
    let _: usize = written;
    Ok(())
}

/// A whole number of a row, if it has one.
fn number(
    field: &Field,
    (table, stamps, head): (&Table, Option<&[RowStamp]>, &Head),
    row: usize,
) -> Option<u64> {
    let stamp = stamps.and_then(|stamps| stamps.get(row));
    match field.name {
        "row" => Some(table.file_row(row) as u64),
        "robot_id" => robot_id(head).map(u64::from),
        // A signed number: times beyond the year 2262 have no value.
        "unix_ns" => {
            stamp.map(|stamp| stamp.unix_ns).filter(|unix_ns| i64::try_from(*unix_ns).is_ok())
        }
        "stamp_ns" => stamp.map(|stamp| stamp.stamp_ns),
        "measured_ns" => {
            stamp.map(|stamp| stamp.measured_ns).filter(|measured_ns| *measured_ns > 0)
        }
        "seq" => stamp.map(|stamp| stamp.seq),
        "flags" => stamp.map(|stamp| u64::from(stamp.flags)),
        _ => None,
    }
}

/// The robot's name without the fleet's, as a number, if it is the plain spelling of one.
fn robot_id(head: &Head) -> Option<u32> {
    let name = head.robot.as_deref()?;
    let name = match &head.fleet {
        Some(fleet) => name
            .strip_prefix(fleet.as_str())
            .and_then(|rest| rest.strip_prefix('/'))
            .unwrap_or(name),
        None => name,
    };
    let id: u32 = name.parse().ok()?;
    (id.to_string() == name).then_some(id)
}

/// A writer that counts bytes and computes their checksum.
struct Summed<W> {
    out: W,
    bytes: u64,
    crc: crc32fast::Hasher,
}

impl<W: Write> Write for Summed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.bytes += written as u64;
        self.crc.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
