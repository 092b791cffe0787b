//! The published layout: a NumPy array of shape (n, 11).

use std::fs::File;
use std::io::{self, Seek as _, SeekFrom};
use std::path::Path;

use crate::npy::{Header, HeaderError};

use super::ColumnMap;
use super::error::{Fault, TrialError};
use super::layout::{mapped, said};
use super::limits::InMemory;
use super::meter::{of_another_kind, truncated};
use super::table::{Cell, Column, LeftOut, Tables, Take, check_value};

const WIDTH: usize = 11;
const ROBOT: usize = 0;
const TIME: usize = 1;
const BLOCK_ROWS: usize = 1 << 14;

/// Reads the array part by part. The size of the file bounds what its header may claim.
pub(super) fn read(
    path: &Path,
    mut file: File,
    map: &ColumnMap,
    in_memory: InMemory,
    take: &mut Take<'_>,
) -> Result<(), TrialError> {
    let io = TrialError::io(path);
    let file_bytes = file.metadata().map_err(io)?.len();
    file.rewind().map_err(io)?;
    let header = Header::read(&mut file).map_err(|error| refused(path, error))?;
    let (stated_rows, item_bytes) = check_array(path, &header)?;

    let header_bytes = header.length() as u64;
    let row_bytes = WIDTH as u64 * item_bytes;
    let expected_bytes = header_bytes + stated_rows as u64 * row_bytes;
    let (mut rows, mut left_out) = (stated_rows, LeftOut::default());
    if file_bytes < expected_bytes {
        let missing = expected_bytes - file_bytes;
        rows = (file_bytes.saturating_sub(header_bytes) / row_bytes) as usize;
        let missing = match header.fortran_order {
            true => format!("{missing} of {expected_bytes} bytes, with its last columns,"),
            false => format!("{missing} of {expected_bytes} bytes"),
        };
        let missing = format!("{missing} missing");
        if header.fortran_order || rows < 2 || !map.leaves_out() {
            return Err(truncated(path, &missing, rows));
        }
        left_out.add(rows + 1, missing);
        left_out.lines = stated_rows - rows;
    }
    if file_bytes > expected_bytes {
        let what = format!(
            "{file_bytes} bytes, but the header's {rows} rows end at {expected_bytes}. Another file \
             may have been appended"
        );
        return Err(TrialError::new(path, Fault::TrailingBytes, what));
    }
    let missing = map.missing();
    let mut tables = Tables::default();
    let mut robot = (f64::NAN, String::new());
    let mut from = 0;
    while from < rows {
        let count = BLOCK_ROWS.min(rows - from);
        let mut read = |element: u64, count| {
            file.seek(SeekFrom::Start(header_bytes + element * item_bytes))?;
            header.floats(&mut file, count)
        };
        let block = match header.fortran_order {
            false => read((from * WIDTH) as u64, count * WIDTH).map_err(io)?,
            true => {
                let column = |column| read((column * rows + from) as u64, count);
                let columns: io::Result<Vec<_>> = (0..WIDTH).map(column).collect();
                columns.map_err(io)?.concat()
            }
        };
        for row in 0..count {
            let at = |column: usize| match header.fortran_order {
                false => block[row * WIDTH + column],
                true => block[column * count + row],
            };
            let row = from + row + 1;
            let known = |column: usize| match at(column) {
                value if column > TIME && missing.contains(&value) => f64::NAN,
                value => value,
            };
            take_row(Cell { path, row }, known, &mut robot, &mut tables)?;
            if let Some(mut parts) = tables.complete(path, in_memory)? {
                map.turn_as_configured(&mut parts);
                if parts.into_iter().try_for_each(&mut *take).is_break() {
                    return Ok(());
                }
            }
        }
        from += count;
    }
    let mut tables = tables.finish(path, &[], false);
    if let Some(first) = tables.first_mut() {
        first.left_out = left_out;
    }
    map.turn_as_configured(&mut tables);
    // Whether it wants more makes no difference.
    let _ = tables.into_iter().try_for_each(take);
    Ok(())
}

fn refused(path: &Path, error: HeaderError) -> TrialError {
    match error {
        HeaderError::Io(source) => TrialError::io(path)(source),
        HeaderError::Truncated { .. } => truncated(path, &error.to_string(), 0),
        HeaderError::Magic => of_another_kind(path, "a file named .npy that is not a NumPy array"),
        HeaderError::Records => of_type(path, "record"),
        HeaderError::Shape { found } => of_shape(path, &found),
        HeaderError::Malformed { detail, .. } => {
            TrialError::new(path, Fault::NpyHeader, format!("array header: {detail}"))
        }
    }
}

fn of_type(path: &Path, found: &str) -> TrialError {
    let what = format!("found elements of type {found}, allowed: f4 or f8");
    TrialError::new(path, Fault::ElementType, what)
}

fn of_shape(path: &Path, found: &str) -> TrialError {
    let what = format!("found shape ({found}), allowed: (n, 11) with n ≥ 2");
    TrialError::new(path, Fault::Shape, what)
}

fn check_array(path: &Path, header: &Header) -> Result<(usize, u64), TrialError> {
    let item_bytes = match header.element.as_str() {
        "|O" => {
            let what = "found an array of Python objects, which is never read. Save the table as a \
                plain float64 array";
            return Err(TrialError::new(path, Fault::ObjectArray, what));
        }
        "<f4" | ">f4" => 4,
        "<f8" | ">f8" => 8,
        element => return Err(of_type(path, &format!("'{element}'"))),
    };
    match *header.shape {
        [rows, WIDTH] if rows >= 2 => Ok((rows, item_bytes)),
        ref shape => {
            let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
            Err(of_shape(path, &sizes.join(", ")))
        }
    }
}

/// Takes a row. `last` is the robot of the row before: its number and its name.
fn take_row(
    cell: Cell<'_>,
    at: impl Fn(usize) -> f64,
    last: &mut (f64, String),
    tables: &mut Tables,
) -> Result<(), TrialError> {
    let robot = at(ROBOT);
    if robot.is_infinite() {
        return Err(cell.refuse("robot_id", robot.to_string(), "NaN or a finite number"));
    }
    if robot.to_bits() != last.0.to_bits() {
        let name = if robot.is_nan() { String::new() } else { robot.to_string() };
        *last = (robot, name);
    }
    let table = tables.of(cell, &last.1)?;
    table.push_time(cell, at(TIME))?;
    let mut values = [f64::NAN; Column::ALL.len()];
    let columns = || Column::ALL.into_iter().zip(TIME + 1..WIDTH);
    for (column, position) in columns() {
        values[column as usize] = at(position);
        check_value(cell, column.name(), column, column.si(at(position)))?;
    }
    let said = said(&values, false);
    mapped(&mut values, said);
    for (column, _) in columns() {
        table.push_checked(column, values[column as usize]);
    }
    Ok(())
}
