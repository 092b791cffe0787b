//! The table as CSV with a header, plain or compressed.

use std::io::{self, ErrorKind, Read};
use std::path::Path;

use csv::ByteRecord;
use flate2::bufread::MultiGzDecoder;

use super::TrialError;
use super::limits::{FREE_TEXT_BYTES, MAX_EXPANSION, MAX_ROW_BYTES, MAX_TEXT_BYTES};
use super::names::{ColumnMap, Quantity, accepted};
use super::table::{Cell, Column, SourceColumn, TIME_NAMES, Table, Tables};

/// Reads the table; `zipped`: the bytes are gzip, with the size of the file.
pub(super) fn read(
    path: &Path,
    source: Box<dyn Read>,
    zipped: Option<u64>,
    map: &ColumnMap,
) -> Result<Vec<Table>, TrialError> {
    let (source, allowed): (Box<dyn Read>, u64) = match zipped {
        Some(bytes) => {
            let source = MultiGzDecoder::new(io::BufReader::new(source));
            let allowed = bytes.saturating_mul(MAX_EXPANSION).max(FREE_TEXT_BYTES);
            (Box::new(source), allowed.min(MAX_TEXT_BYTES))
        }
        None => (source, MAX_TEXT_BYTES),
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(Meter {
            source,
            bytes: 0,
            allowed,
            row_bytes: 0,
            last: b'\n',
        });
    let header = match reader.byte_headers() {
        Ok(header) => header.clone(),
        Err(error) => return Err(explain(path, zipped, reader.get_ref(), 0, error)),
    };
    if header.as_slice().starts_with(crate::npy::MAGIC) {
        return Err(TrialError::Kind {
            path: path.to_owned(),
            found: "a compressed NumPy array (decompress it first)",
        });
    }
    let (layout, sources, ignored_columns) = Layout::find(path, &header, map)?;
    let mut tables = Tables::default();
    let mut record = ByteRecord::new();
    let mut rows = 0;
    loop {
        match reader.read_byte_record(&mut record) {
            Ok(true) => layout.take_row(
                Cell {
                    path,
                    row: rows + 1,
                },
                &record,
                &mut tables,
            )?,
            Ok(false) => break,
            Err(error) => return Err(explain(path, zipped, reader.get_ref(), rows, error)),
        }
        rows += 1;
        reader.get_mut().row_bytes = 0;
    }
    let no_final_line_break = !matches!(reader.get_ref().last, b'\n' | b'\r');
    let mut tables = tables.finish(path, &ignored_columns, no_final_line_break);
    for table in &mut tables {
        table.sources.clone_from(&sources);
    }
    Ok(tables)
}

/// Limits the size of the text and of each row, and records whether the text ends with a newline.
struct Meter {
    source: Box<dyn Read>,
    bytes: u64,
    allowed: u64,
    /// Bytes read since the end of the last complete row.
    row_bytes: u64,
    last: u8,
}

impl Meter {
    const fn is_too_long(&self) -> bool {
        self.bytes > self.allowed || self.row_bytes > MAX_ROW_BYTES
    }
}

impl Read for Meter {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.source.read(buffer)?;
        self.bytes += read as u64;
        self.row_bytes += read as u64;
        if self.is_too_long() {
            return Err(io::Error::other("too long"));
        }
        if let Some(last) = buffer[..read].last() {
            self.last = *last;
        }
        Ok(read)
    }
}

fn explain(
    path: &Path,
    zipped: Option<u64>,
    meter: &Meter,
    rows: usize,
    error: csv::Error,
) -> TrialError {
    let (path, allowed) = (path.to_owned(), meter.allowed);
    match zipped {
        _ if !meter.is_too_long() => {}
        _ if meter.bytes <= allowed => return TrialError::RowTooLong { path, rows },
        Some(found) if allowed < MAX_TEXT_BYTES => {
            return TrialError::Expands {
                path,
                found,
                allowed,
            };
        }
        _ => return TrialError::TooLong { path },
    }
    let zipped = zipped.is_some();
    let source = match error.into_kind() {
        csv::ErrorKind::Io(source) => source,
        // Neither occurs: rows are read as bytes, and may have any length.
        other => io::Error::other(format!("{other:?}")),
    };
    match source.kind() {
        ErrorKind::UnexpectedEof if zipped => TrialError::Truncated {
            path,
            missing: "the gzip stream has no end".to_owned(),
            rows,
        },
        ErrorKind::InvalidInput | ErrorKind::InvalidData if zipped => TrialError::Gzip {
            path,
            rows,
            detail: source.to_string(),
        },
        _ => TrialError::Io { path, source },
    }
}

/// Position of each column of the table in a row, and the factor to the unit of the layout.
struct Layout {
    fields: usize,
    robot: Option<usize>,
    time: (usize, f64),
    columns: Vec<(Column, usize, f64)>,
    /// Whether power is voltage times current.
    by_product: bool,
}

impl Layout {
    fn find(
        path: &Path,
        header: &ByteRecord,
        map: &ColumnMap,
    ) -> Result<(Self, Vec<SourceColumn>, Vec<String>), TrialError> {
        let names = header
            .iter()
            .map(|name| String::from_utf8_lossy(name).into_owned())
            .collect::<Vec<_>>();
        if let [only] = names.as_slice()
            && let Some(found) = only.chars().find(|each| matches!(each, ';' | '\t' | '|'))
        {
            return Err(TrialError::Separator {
                path: path.to_owned(),
                found,
            });
        }
        let shown = || names.join(", ").chars().take(400).collect::<String>();
        let absent = map
            .named()
            .filter(|(_, name)| names.iter().all(|found| found != name));
        let absent: Vec<String> = absent
            .map(|(quantity, name)| format!("{quantity}={name}"))
            .collect();
        if !absent.is_empty() {
            return Err(TrialError::MissingColumns {
                path: path.to_owned(),
                missing: format!("mapped: {}", absent.join(", ")),
                found: shown(),
            });
        }
        let mut used = vec![false; names.len()];
        let mut find = |quantity| match map.positions(quantity, &names).as_slice() {
            [] => Ok(None),
            [one] => {
                used[one.position] = true;
                Ok(Some(*one))
            }
            [first, second, ..] => Err(TrialError::DuplicateColumn {
                path: path.to_owned(),
                first: names[first.position].clone(),
                second: names[second.position].clone(),
            }),
        };
        let robot = find(Quantity::Robot)?.map(|found| found.position);
        let time = find(Quantity::Time)?.map(|found| (found.position, found.factor));
        let (mut columns, mut sources) = (Vec::new(), Vec::new());
        for column in Column::ALL {
            let quantity = Quantity::Column(column);
            if let Some(found) = find(quantity)? {
                columns.push((column, found.position, found.factor));
                sources.push(SourceColumn {
                    column,
                    name: names[found.position].clone(),
                    states_unit: found.states_unit,
                    is_mapped: map.maps(quantity),
                });
            }
        }
        let has = |wanted| columns.iter().any(|(column, ..)| *column == wanted);
        let by_product = !has(Column::Power) && has(Column::Voltage) && has(Column::Current);
        let mut missing = Vec::new();
        if time.is_none() {
            missing.push(accepted(Quantity::Time));
        }
        if !has(Column::Power) && !by_product {
            missing.push(format!(
                "{}, or voltage and current",
                accepted(Quantity::Column(Column::Power))
            ));
        }
        let Some(time) = time.filter(|_| missing.is_empty()) else {
            return Err(TrialError::MissingColumns {
                path: path.to_owned(),
                missing: missing.join(" and "),
                found: shown(),
            });
        };
        let layout = Self {
            fields: names.len(),
            robot,
            time,
            columns,
            by_product,
        };
        let ignored_columns = names
            .into_iter()
            .zip(used)
            .filter_map(|(name, used)| (!used).then_some(name))
            .collect();
        Ok((layout, sources, ignored_columns))
    }

    fn take_row(
        &self,
        cell: Cell<'_>,
        record: &ByteRecord,
        tables: &mut Tables,
    ) -> Result<(), TrialError> {
        if record.len() != self.fields {
            return Err(TrialError::FieldCount {
                path: cell.path.to_owned(),
                row: cell.row,
                found: record.len(),
                expected: self.fields,
            });
        }
        let name = self
            .robot
            .map(|position| String::from_utf8_lossy(&record[position]));
        let name = name.filter(|name| !name.eq_ignore_ascii_case("nan"));
        let table = tables.of(cell, name.as_deref().unwrap_or_default())?;
        let (position, factor) = self.time;
        let time_s = number(cell, TIME_NAMES[0], &record[position])? * factor;
        table.push_time(cell, time_s)?;
        let (mut voltage_mv, mut current_ma) = (f64::NAN, f64::NAN);
        for (column, position, factor) in &self.columns {
            let value = number(cell, column.name(), &record[*position])? * factor;
            match column {
                Column::Voltage => voltage_mv = value,
                Column::Current => current_ma = value,
                _ => {}
            }
            table.push(cell, *column, value)?;
        }
        if self.by_product {
            table.push(cell, Column::Power, voltage_mv * current_ma / 1000.0)?;
        }
        Ok(())
    }
}

fn number(cell: Cell<'_>, column: &'static str, field: &[u8]) -> Result<f64, TrialError> {
    if field.is_empty() {
        return Ok(f64::NAN);
    }
    std::str::from_utf8(field)
        .ok()
        .and_then(|text| text.parse().ok())
        .ok_or_else(|| {
            let found = String::from_utf8_lossy(field);
            let found = found.chars().take(60).collect::<String>();
            cell.refuse(column, found, "a number, NaN, or nothing")
        })
}
