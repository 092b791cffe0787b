//! The published layout: a NumPy array of shape (n, 11).

use std::io::Read;
use std::path::Path;

use crate::npy::{Header, HeaderError};

use super::table::{Cell, Column, Table, Tables};
use super::{MAX_ROWS, TrialError};

const WIDTH: usize = 11;
const ROBOT: usize = 0;
const TIME: usize = 1;

/// Reads the array; `file_bytes` bounds the size that its header may claim.
pub(super) fn read(
    path: &Path,
    mut source: impl Read,
    file_bytes: u64,
) -> Result<Vec<Table>, TrialError> {
    let header = Header::read(&mut source).map_err(|error| refused(path, error))?;
    let (rows, item_bytes) = check_array(path, &header)?;

    let header_bytes = header.length() as u64;
    let row_bytes = WIDTH as u64 * item_bytes;
    let expected_bytes = header_bytes + rows as u64 * row_bytes;
    if file_bytes < expected_bytes {
        return Err(TrialError::Truncated {
            path: path.to_owned(),
            missing: format!(
                "{} of {expected_bytes} bytes missing",
                expected_bytes - file_bytes
            ),
            rows: (file_bytes.saturating_sub(header_bytes) / row_bytes) as usize,
        });
    }
    if file_bytes > expected_bytes {
        return Err(TrialError::TrailingBytes {
            path: path.to_owned(),
            rows,
            found_bytes: file_bytes,
            expected_bytes,
        });
    }
    let fortran_order = header.fortran_order;
    let values = header.floats(source).map_err(|source| io(path, source))?;
    fill(path, &values, rows, fortran_order)
}

fn refused(path: &Path, error: HeaderError) -> TrialError {
    let path = path.to_owned();
    match error {
        HeaderError::Io(source) => TrialError::Io { path, source },
        HeaderError::Truncated { .. } => TrialError::Truncated {
            path,
            missing: error.to_string(),
            rows: 0,
        },
        HeaderError::Magic => TrialError::Kind {
            path,
            found: "a file named .npy that is not a NumPy array".to_owned(),
        },
        HeaderError::Records => TrialError::ElementType {
            path,
            found: "record".to_owned(),
        },
        HeaderError::Shape { found } => TrialError::Shape { path, found },
        HeaderError::Malformed { detail, .. } => TrialError::NpyHeader { path, detail },
    }
}

/// Number of rows and bytes per element.
fn check_array(path: &Path, header: &Header) -> Result<(usize, u64), TrialError> {
    let path = || path.to_owned();
    let item_bytes = match header.element.as_str() {
        "|O" => return Err(TrialError::ObjectArray { path: path() }),
        "<f4" | ">f4" => 4,
        "<f8" | ">f8" => 8,
        element => {
            return Err(TrialError::ElementType {
                path: path(),
                found: format!("'{element}'"),
            });
        }
    };
    match *header.shape {
        [rows, WIDTH] if rows > MAX_ROWS => Err(TrialError::TooManyRows { path: path() }),
        [rows, WIDTH] if rows >= 2 => Ok((rows, item_bytes)),
        ref shape => {
            let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
            Err(TrialError::Shape {
                path: path(),
                found: sizes.join(", "),
            })
        }
    }
}

fn fill(
    path: &Path,
    values: &[f64],
    rows: usize,
    fortran_order: bool,
) -> Result<Vec<Table>, TrialError> {
    let mut tables = Tables::default();
    let mut last = (f64::NAN, String::new());
    for row in 0..rows {
        let at = |column: usize| match fortran_order {
            false => values[row * WIDTH + column],
            true => values[column * rows + row],
        };
        let cell = Cell { path, row: row + 1 };
        let robot = at(ROBOT);
        if robot.is_infinite() {
            return Err(cell.refuse("robot_id", robot.to_string(), "NaN or a finite number"));
        }
        if robot.to_bits() != last.0.to_bits() {
            let name = if robot.is_nan() {
                String::new()
            } else {
                robot.to_string()
            };
            last = (robot, name);
        }
        let table = tables.of(cell, &last.1)?;
        table.push_time(cell, at(TIME))?;
        for (column, position) in Column::ALL.into_iter().zip(TIME + 1..WIDTH) {
            table.push(cell, column, at(position))?;
        }
    }
    Ok(tables.finish(path, &[], false))
}

fn io(path: &Path, source: std::io::Error) -> TrialError {
    TrialError::Io {
        path: path.to_owned(),
        source,
    }
}
