//! The published layout: a NumPy array of shape (n, 11).

use std::io::Read;
use std::path::Path;

use npyz::{DType, NpyFile, Order, TypeChar};

use super::table::{Cell, Column, Table, Tables};
use super::{MAX_ROWS, NPY_MAGIC, TrialError};

const WIDTH: usize = 11;
const ROBOT: usize = 0;
const TIME: usize = 1;
/// NumPy itself reads no longer header unless told to.
const MAX_HEADER_BYTES: usize = 10_000;

/// Reads the array; `file_bytes` bounds what its header may claim.
pub(super) fn read(
    path: &Path,
    mut source: impl Read,
    file_bytes: u64,
) -> Result<Vec<Table>, TrialError> {
    let header = read_header(path, &mut source)?;
    let header_bytes = header.len() as u64;
    check_header(path, &header)?;
    let array = NpyFile::new(header.as_slice().chain(source))
        .map_err(|error| bad_header(path, error.to_string()))?;
    let (rows, item_bytes) = check_array(path, &array)?;

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
    let order = array.order();
    let values = read_values(path, array)?;
    fill(path, &values, rows, order)
}

/// Everything before the data: magic, version, length, and the text of that length.
fn read_header(path: &Path, source: &mut impl Read) -> Result<Vec<u8>, TrialError> {
    let mut header = Vec::new();
    read_until(path, source, &mut header, NPY_MAGIC.len() + 2)?;
    if !header.starts_with(NPY_MAGIC) {
        return Err(TrialError::Kind {
            path: path.to_owned(),
            found: "a file named .npy that is no NumPy array",
        });
    }
    let length_bytes = match header[NPY_MAGIC.len()] {
        1 => 2,
        2 | 3 => 4,
        version => {
            let detail = format!("found format version {version}; allowed: 1, 2 or 3");
            return Err(bad_header(path, detail));
        }
    };
    let length_at = header.len();
    read_until(path, source, &mut header, length_at + length_bytes)?;
    let text_bytes = header[length_at..]
        .iter()
        .rev()
        .fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
    if text_bytes > MAX_HEADER_BYTES {
        let detail = format!("found a length of {text_bytes} bytes; allowed: {MAX_HEADER_BYTES}");
        return Err(bad_header(path, detail));
    }
    let text_at = header.len();
    read_until(path, source, &mut header, text_at + text_bytes)?;
    Ok(header)
}

fn read_until(
    path: &Path,
    source: &mut impl Read,
    header: &mut Vec<u8>,
    length: usize,
) -> Result<(), TrialError> {
    let wanted = length - header.len();
    let read = source.take(wanted as u64).read_to_end(header);
    match read.map_err(|source| io(path, source))? {
        read if read == wanted => Ok(()),
        _ => Err(TrialError::Truncated {
            path: path.to_owned(),
            missing: format!("the header needs {length} bytes, found {}", header.len()),
            rows: 0,
        }),
    }
}

/// Refuses what the header of a plain two-dimensional array never contains, before the general
/// parser sees it: deep nesting and arithmetic cost it time and stack, and it multiplies the
/// dimensions without looking.
fn check_header(path: &Path, header: &[u8]) -> Result<(), TrialError> {
    let text = &header[header.iter().position(|byte| *byte == b'{').unwrap_or(0)..];
    let count = |wanted: u8| text.iter().filter(|byte| **byte == wanted).count();
    if count(b'[') > 0 {
        return Err(TrialError::ElementType {
            path: path.to_owned(),
            found: "record".to_owned(),
        });
    }
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b" \n{}():,'\"<>=|_".contains(byte);
    let opening = text.iter().position(|byte| *byte == b'(');
    let closing = text.iter().position(|byte| *byte == b')');
    let once = [b'{', b'}', b'(', b')']
        .into_iter()
        .all(|byte| count(byte) == 1);
    let (true, true, Some(opening), Some(closing)) =
        (once, text.iter().all(plain), opening, closing)
    else {
        let found = String::from_utf8_lossy(text);
        let found = found.trim_end().chars().take(200).collect::<String>();
        let allowed = "{'descr': '<f8', 'fortran_order': False, 'shape': (n, 11), }";
        return Err(bad_header(
            path,
            format!("found {found:?}; allowed: {allowed}"),
        ));
    };
    let shape = text.get(opening + 1..closing).unwrap_or_default();
    let shape = String::from_utf8_lossy(shape);
    let shape = shape.trim_end();
    // Python allows a comma after the last, and some programs write it.
    let dimensions = shape.strip_suffix(',').unwrap_or(shape).split(',');
    let dimensions = dimensions.map(str::trim).collect::<Vec<_>>();
    let is_small = |dimension: &&str| {
        (1..=9).contains(&dimension.len()) && dimension.bytes().all(|byte| byte.is_ascii_digit())
    };
    if dimensions.len() != 2 || !dimensions.iter().all(is_small) {
        return Err(TrialError::Shape {
            path: path.to_owned(),
            found: shape.chars().take(200).collect(),
        });
    }
    Ok(())
}

/// Rows of the array and bytes of an element.
fn check_array<R: Read>(path: &Path, array: &NpyFile<R>) -> Result<(usize, u64), TrialError> {
    if array.uses_pickled_array() {
        return Err(TrialError::ObjectArray {
            path: path.to_owned(),
        });
    }
    let item_bytes = match array.dtype() {
        DType::Plain(plain) if plain.type_char() == TypeChar::Float => plain.size_field(),
        _ => 0,
    };
    if !matches!(item_bytes, 4 | 8) {
        return Err(TrialError::ElementType {
            path: path.to_owned(),
            found: array.dtype().descr(),
        });
    }
    match *array.shape() {
        [rows, width] if width == WIDTH as u64 && rows >= 2 => {
            if rows > MAX_ROWS as u64 {
                return Err(TrialError::TooManyRows {
                    path: path.to_owned(),
                });
            }
            Ok((rows as usize, item_bytes))
        }
        ref shape => Err(TrialError::Shape {
            path: path.to_owned(),
            found: shape
                .iter()
                .map(u64::to_string)
                .collect::<Vec<_>>()
                .join(", "),
        }),
    }
}

fn read_values<R: Read>(path: &Path, array: NpyFile<R>) -> Result<Vec<f64>, TrialError> {
    let values = match array.try_data::<f64>() {
        Ok(values) => values.collect::<Result<Vec<_>, _>>(),
        Err(array) => {
            let values = array
                .data::<f32>()
                .map_err(|error| bad_header(path, error.to_string()))?;
            values.map(|value| value.map(f64::from)).collect()
        }
    };
    values.map_err(|source| io(path, source))
}

fn fill(path: &Path, values: &[f64], rows: usize, order: Order) -> Result<Vec<Table>, TrialError> {
    let mut tables = Tables::default();
    let mut last = (f64::NAN, String::new());
    for row in 0..rows {
        let at = |column: usize| match order {
            Order::C => values[row * WIDTH + column],
            Order::Fortran => values[column * rows + row],
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

fn bad_header(path: &Path, detail: impl Into<String>) -> TrialError {
    TrialError::NpyHeader {
        path: path.to_owned(),
        detail: detail.into(),
    }
}

fn io(path: &Path, source: std::io::Error) -> TrialError {
    TrialError::Io {
        path: path.to_owned(),
        source,
    }
}
