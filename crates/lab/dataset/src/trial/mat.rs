//! MATLAB's files of level 5 (v5 to v7): vectors and matrices of numbers, read as columns of a
//! text.
//!
//! The longer side of an array is time. A vector is a column with its name, a matrix `m` has the
//! columns `m_1`, `m_2` and so on. Of all arrays those of the most frequent length are read, others
//! and what is no array of numbers are named in a note.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Read, Seek as _};
use std::path::Path;

use flate2::read::ZlibDecoder;

use super::limits::{FREE_TEXT_BYTES, InMemory, MAX_EXPANSION};
use super::table::Take;
use super::{ColumnMap, TrialError, text};

/// The first bytes of a file.
pub(super) const MAGIC: &[u8] = b"MATLAB 5.0 MAT-file";
/// Bytes before the first element, the last two of which state the byte order.
const HEAD_BYTES: usize = 128;
/// Maximum size of a file and of what is in it.
const MAX_BYTES: u64 = 1 << 30;
/// Most numbers of all arrays, which take 8 bytes each in memory.
const MAX_NUMBERS: usize = (MAX_BYTES / 8) as usize;
/// Columns of a matrix, at most.
const MAX_COLUMNS: usize = 64;

const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
const IS_COMPLEX: u32 = 0x0800;

/// Reads the arrays as a text.
pub(super) fn read(
    path: &Path,
    mut file: File,
    map: &ColumnMap,
    in_memory: InMemory,
    take: &mut Take<'_>,
) -> Result<(), TrialError> {
    let io = TrialError::io(path);
    let mut bytes = Vec::new();
    file.rewind().map_err(io)?;
    let read = file.take(MAX_BYTES + 1).read_to_end(&mut bytes);
    read.map_err(io)?;
    let refused = |what: String| TrialError::Kind {
        path: path.to_owned(),
        found: format!(
            "a MATLAB file {what}. In MATLAB save vectors of numbers, one for each column \
                (`save('log.mat', 't', 'voltage_V', \
             'current_A')`), or `writetable(T, 'log.csv')`. In Python `scipy.io.loadmat`"
        ),
    };
    if bytes.len() as u64 > MAX_BYTES {
        return Err(refused(format!("of more than {MAX_BYTES} bytes, which are allowed")));
    }
    let Some(found) = Variables::parse(&bytes) else {
        return Err(TrialError::Truncated {
            path: path.to_owned(),
            missing: "an element of the MATLAB file is damaged or has no end".to_owned(),
            rows: 0,
        });
    };
    let (columns, mut note) = found.columns();
    if columns.is_empty() {
        let others = note.unwrap_or_else(|| "it has no variables".to_owned());
        return Err(refused(format!("without vectors of numbers ({others})")));
    }
    let source = Box::new(Text { columns, row: None, line: Vec::new(), taken: 0 });
    text::read(path, source, None, map, in_memory, &mut |mut table| {
        table.understood.extend(note.take());
        take(table)
    })
}

/// The variables of a file.
#[derive(Default)]
struct Variables {
    /// Columns of numbers by the length of their array.
    by_length: BTreeMap<usize, Vec<(String, Vec<f64>)>>,
    /// Numbers in all of them.
    numbers: usize,
    /// Variables that are no arrays of numbers.
    others: Vec<String>,
}

impl Variables {
    /// `None` if the file is cut or contradicts itself.
    fn parse(bytes: &[u8]) -> Option<Self> {
        let is_big = match bytes.get(HEAD_BYTES - 2..HEAD_BYTES)? {
            b"IM" => false,
            b"MI" => true,
            _ => return None,
        };
        let zipped_bytes = bytes.len() as u64;
        let mut room = (zipped_bytes * MAX_EXPANSION).clamp(FREE_TEXT_BYTES, MAX_BYTES);
        let mut found = Self::default();
        let mut rest = Elements { bytes: &bytes[HEAD_BYTES..], is_big };
        while !rest.bytes.is_empty() {
            match rest.next()? {
                (COMPRESSED, zipped) => {
                    let mut whole = Vec::new();
                    let mut decoder = ZlibDecoder::new(zipped).take(room);
                    decoder.read_to_end(&mut whole).ok()?;
                    room -= whole.len() as u64;
                    let bytes = &whole[..];
                    let (kind, matrix) = Elements { bytes, is_big }.next()?;
                    (kind == MATRIX).then_some(())?;
                    found.take(matrix, is_big)?;
                }
                (MATRIX, matrix) => found.take(matrix, is_big)?,
                // Nothing else is in a file of MATLAB.
                _ => return None,
            }
        }
        Some(found)
    }

    fn take(&mut self, matrix: &[u8], is_big: bool) -> Option<()> {
        if matrix.is_empty() {
            return Some(());
        }
        let mut rest = Elements { bytes: matrix, is_big };
        let flags = Elements { bytes: rest.next()?.1, is_big };
        let flags = flags.word(0)?;
        let class = flags & 0xff;
        let kind = match class {
            6..=15 if flags & IS_COMPLEX == 0 => None,
            6..=15 => Some("complex numbers"),
            1 => Some("a cell array"),
            2 => Some("a struct"),
            4 => Some("a text"),
            5 => Some("a sparse matrix"),
            // No dimensions follow an opaque object.
            17 => {
                self.others.push("a table, timetable or other object".to_owned());
                return Some(());
            }
            _ => Some("an object"),
        };
        let sizes = Elements { bytes: rest.next()?.1, is_big };
        let dimensions = sizes.bytes.len() / 4;
        let name = String::from_utf8_lossy(rest.next()?.1);
        let plain = |letter: char| match letter.is_ascii_alphanumeric() {
            true => letter,
            false => '_',
        };
        let name: String = name.chars().take(100).map(plain).collect();
        let (rows, columns) = (sizes.word(0)? as usize, sizes.word(1)? as usize);
        let (length, width) = (rows.max(columns), rows.min(columns));
        let other = match kind {
            Some(kind) => kind.to_owned(),
            None if dimensions != 2 => format!("an array of {dimensions} dimensions"),
            None if length < 2 || width == 0 => "a single number, or none".to_owned(),
            None if name.is_empty() => return Some(()),
            None if !self.has_room(length, width) => {
                format!("one of too many numbers: {MAX_NUMBERS} are read")
            }
            None if width > MAX_COLUMNS => format!("a matrix of {rows} × {columns}"),
            None => {
                let (element, values) = rest.next()?;
                let values = numbers(element, values, is_big)?;
                (values.len() == length.checked_mul(width)?).then_some(())?;
                let own = self.by_length.entry(length).or_default();
                // Arrays lie column by column.
                let at = |place: usize, column: usize| match rows >= columns {
                    true => column * rows + place,
                    false => place * rows + column,
                };
                own.extend((0..width).map(|column| {
                    let values = (0..length).map(|place| values[at(place, column)]);
                    let name = match width {
                        1 => name.clone(),
                        _ => format!("{name}_{}", column + 1),
                    };
                    (name, values.collect())
                }));
                return Some(());
            }
        };
        self.others.push(format!("{name} is {other}"));
        Some(())
    }

    /// True if so many numbers more fit into memory, where each takes 8 bytes.
    fn has_room(&mut self, length: usize, width: usize) -> bool {
        let numbers = self.numbers.saturating_add(length.saturating_mul(width));
        let fits = numbers <= MAX_NUMBERS;
        if fits {
            self.numbers = numbers;
        }
        fits
    }

    /// The columns of the most frequent length, and what else there is.
    fn columns(mut self) -> (Vec<(String, Vec<f64>)>, Option<String>) {
        let lengths = self.by_length.iter();
        let most = lengths.max_by_key(|(length, columns)| (columns.len(), **length));
        let Some(length) = most.map(|(length, _)| *length) else {
            return (Vec::new(), self.note());
        };
        let columns = self.by_length.remove(&length).unwrap_or_default();
        for (other, columns) in std::mem::take(&mut self.by_length) {
            let names = columns.iter().map(|(name, _)| {
                format!("{name} has {other} numbers, where most arrays have {length}")
            });
            self.others.extend(names);
        }
        (columns, self.note())
    }

    fn note(&self) -> Option<String> {
        const SHOWN: usize = 8;
        let more = match self.others.len().saturating_sub(SHOWN) {
            0 => String::new(),
            more => format!(", and {more} more"),
        };
        let shown = self.others.iter().take(SHOWN).cloned();
        let shown = shown.collect::<Vec<_>>().join(", ");
        (!self.others.is_empty()).then(|| format!("not read: {shown}{more}"))
    }
}

/// Elements one after another, each with its kind and its size in front.
struct Elements<'a> {
    bytes: &'a [u8],
    is_big: bool,
}

impl<'a> Elements<'a> {
    /// The number at a place.
    fn word(&self, at: usize) -> Option<u32> {
        let bytes = *self.bytes.get(4 * at..)?.first_chunk()?;
        Some(match self.is_big {
            true => u32::from_be_bytes(bytes),
            false => u32::from_le_bytes(bytes),
        })
    }

    /// The next element: its kind and its bytes.
    fn next(&mut self) -> Option<(u32, &'a [u8])> {
        let first = self.word(0)?;
        // A small one has its size beside its kind, and its bytes in the second word.
        let (kind, from, size, end) = match first >> 16 {
            0 => {
                let size = self.word(1)? as usize;
                let end = match first {
                    COMPRESSED => 8 + size,
                    _ => 8 + size.next_multiple_of(8),
                };
                (first, 8, size, end)
            }
            size => (first & 0xffff, 4, size as usize, 8),
        };
        let element = self.bytes.get(from..)?.get(..size)?;
        // The last one may lack what fills it up.
        self.bytes = &self.bytes[end.min(self.bytes.len())..];
        Some((kind, element))
    }
}

/// The numbers of an element.
fn numbers(kind: u32, bytes: &[u8], is_big: bool) -> Option<Vec<f64>> {
    macro_rules! of {
        ($number:ty) => {
            bytes
                .as_chunks::<{ size_of::<$number>() }>()
                .0
                .iter()
                .map(|bytes| match is_big {
                    true => <$number>::from_be_bytes(*bytes) as f64,
                    false => <$number>::from_le_bytes(*bytes) as f64,
                })
                .collect()
        };
    }
    Some(match kind {
        1 => of!(i8),
        2 => of!(u8),
        3 => of!(i16),
        4 => of!(u16),
        5 => of!(i32),
        6 => of!(u32),
        7 => of!(f32),
        9 => of!(f64),
        12 => of!(i64),
        13 => of!(u64),
        _ => return None,
    })
}

/// The columns as lines, the first with their names.
struct Text {
    columns: Vec<(String, Vec<f64>)>,
    /// The next row. None before the names.
    row: Option<usize>,
    line: Vec<u8>,
    taken: usize,
}

impl Read for Text {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.taken == self.line.len() {
            let mut line = String::new();
            for (name, values) in &self.columns {
                // Writing to a String cannot fail.
                let _ = match (self.row, self.row.and_then(|row| values.get(row))) {
                    (None, _) => write!(line, "{name},"),
                    (_, Some(value)) => write!(line, "{value},"),
                    (_, None) => return Ok(0),
                };
            }
            line.pop();
            line.push('\n');
            self.row = Some(self.row.map_or(0, |row| row + 1));
            (self.line, self.taken) = (line.into_bytes(), 0);
        }
        let read = (&self.line[self.taken..]).read(buffer)?;
        self.taken += read;
        Ok(read)
    }
}
