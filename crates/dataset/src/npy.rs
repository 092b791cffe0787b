//! The header of NumPy's array files, for recordings and model files alike.
//!
//! A header is untrusted: no allocation depends on a size that it merely claims, and constructs
//! that a plain array's header never contains are refused before the general parser sees them,
//! which nests, multiplies and concatenates without bounds.

use std::io::{self, Read};

use npyz::{DType, NpyFile, NpyHeader, Order};

/// The first bytes of every array file.
pub const MAGIC: &[u8] = b"\x93NUMPY";
/// NumPy's own default limit for a header's length.
const MAX_TEXT_BYTES: usize = 10_000;
/// Most dimensions, and most digits of each.
const MAX_DIMENSIONS: usize = 8;
const MAX_DIGITS: usize = 9;
/// Bytes of magic and version.
const VERSION_END: usize = 8;

/// Why a header could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HeaderError {
    /// The source could not be read.
    #[error("the header could not be read: {0}")]
    Io(#[from] io::Error),
    /// The source ends within the header.
    #[error("the header needs {needed} bytes, found {found}")]
    Truncated {
        /// Bytes needed.
        needed: usize,
        /// Bytes found.
        found: usize,
    },
    /// Wrong magic bytes.
    #[error("found no NumPy magic bytes")]
    Magic,
    /// The header is not that of a plain array.
    #[error("{detail}")]
    Malformed {
        /// Offset in the file.
        at: usize,
        /// What was found and what is allowed.
        detail: String,
    },
    /// The elements are records.
    #[error("found records; allowed: plain elements")]
    Records,
    /// There are too many dimensions, or too large ones.
    #[error(
        "found shape ({found}); allowed: up to {MAX_DIMENSIONS} dimensions of up to {MAX_DIGITS} digits"
    )]
    Shape {
        /// The shape as stated.
        found: String,
    },
}

impl HeaderError {
    /// Offset of the error in the file.
    #[must_use]
    pub fn at(&self) -> usize {
        match self {
            Self::Truncated { found, .. } => *found,
            Self::Malformed { at, .. } => *at,
            Self::Io(_) | Self::Magic | Self::Records | Self::Shape { .. } => 0,
        }
    }
}

/// The header of an array.
#[derive(Clone, Debug)]
pub struct Header {
    raw: Vec<u8>,
    /// Type of the elements in NumPy's notation, such as `<f4`.
    pub element: String,
    /// Whether the first dimension varies fastest (Fortran order).
    pub fortran_order: bool,
    /// Elements in each dimension; their product fits into 64 bits.
    pub shape: Vec<usize>,
}

impl Header {
    /// Reads the header; the source is then positioned at the first element.
    ///
    /// # Errors
    /// [`HeaderError`]: not the header of a plain array, or truncated.
    pub fn read(mut source: impl Read) -> Result<Self, HeaderError> {
        let mut bytes = Vec::new();
        read_until(&mut source, &mut bytes, VERSION_END)?;
        if !bytes.starts_with(MAGIC) {
            return Err(HeaderError::Magic);
        }
        let text_at = match bytes[MAGIC.len()..] {
            [1, 0] => VERSION_END + 2,
            [2 | 3, 0] => VERSION_END + 4,
            ref version => {
                let [major, minor] = [version[0], version[1]];
                let detail =
                    format!("found format version {major}.{minor}; allowed: 1.0, 2.0 and 3.0");
                return Err(malformed(MAGIC.len(), detail));
            }
        };
        read_until(&mut source, &mut bytes, text_at)?;
        let length = bytes[VERSION_END..].iter().rev();
        let length = length.fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
        if length > MAX_TEXT_BYTES {
            let detail = format!("found a length of {length} bytes; allowed: {MAX_TEXT_BYTES}");
            return Err(malformed(VERSION_END, detail));
        }
        read_until(&mut source, &mut bytes, text_at + length)?;
        check_text(text_at, &bytes[text_at..])?;
        let parsed = NpyHeader::from_reader(bytes.as_slice())
            .map_err(|error| malformed(text_at, error.to_string()))?;
        let DType::Plain(element) = parsed.dtype() else {
            return Err(HeaderError::Records);
        };
        Ok(Self {
            element: element.to_string(),
            fortran_order: parsed.order() == Order::Fortran,
            shape: parsed.shape().iter().map(|size| *size as usize).collect(),
            raw: bytes,
        })
    }

    /// Length of the header in bytes: where the elements begin.
    #[must_use]
    pub fn length(&self) -> usize {
        self.raw.len()
    }

    /// The elements, floats of 4 or 8 bytes, in the order of the file.
    pub(crate) fn floats(&self, source: impl Read) -> io::Result<Vec<f64>> {
        match NpyFile::new(self.raw.as_slice().chain(source))?.try_data::<f64>() {
            Ok(values) => values.collect(),
            Err(array) => {
                let values = array.data::<f32>().map_err(io::Error::other)?;
                values.map(|value| value.map(f64::from)).collect()
            }
        }
    }
}

/// The header that NumPy writes for an array in C order; `element` is the type in its notation. The
/// elements begin at a multiple of 64 bytes.
#[must_use]
pub fn header(element: &str, shape: &[usize]) -> Vec<u8> {
    const ALIGNMENT: usize = 64;
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let sizes = sizes.join(", ");
    let text =
        format!("{{'descr': '{element}', 'fortran_order': False, 'shape': ({sizes}{comma}), }}");
    let text_at = VERSION_END + 2;
    let width = (text_at + text.len() + 1).next_multiple_of(ALIGNMENT) - text_at - 1;
    let mut header = MAGIC.to_vec();
    header.extend([1, 0]);
    // A line with a few sizes: far below 64 KiB.
    header.extend((width as u16 + 1).to_le_bytes());
    header.extend(format!("{text:width$}\n").into_bytes());
    header
}

fn read_until(
    source: &mut impl Read,
    header: &mut Vec<u8>,
    needed: usize,
) -> Result<(), HeaderError> {
    let missing = needed - header.len();
    match source.take(missing as u64).read_to_end(header)? {
        read if read == missing => Ok(()),
        _ => Err(HeaderError::Truncated {
            needed,
            found: header.len(),
        }),
    }
}

fn malformed(at: usize, detail: String) -> HeaderError {
    HeaderError::Malformed { at, detail }
}

/// Refuses constructs that the header of a plain array never contains.
fn check_text(at: usize, text: &[u8]) -> Result<(), HeaderError> {
    if text.contains(&b'[') {
        return Err(HeaderError::Records);
    }
    let place = |wanted: u8| {
        let mut found = text.iter().enumerate().filter(|(_, byte)| **byte == wanted);
        let (first, again) = (found.next(), found.next());
        first.filter(|_| again.is_none()).map(|(place, _)| place)
    };
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b" \n{}():,'\"<>=|_".contains(byte);
    let (Some(_), Some(_), Some(opening), Some(closing), true, Some(b'\n')) = (
        place(b'{'),
        place(b'}'),
        place(b'('),
        place(b')'),
        text.iter().all(plain),
        text.last(),
    ) else {
        let found = String::from_utf8_lossy(text);
        let found: String = found.trim_end().chars().take(200).collect();
        let allowed = "{'descr': '<f8', 'fortran_order': False, 'shape': (n, 11), }";
        return Err(malformed(
            at,
            format!("found {found:?}; allowed: {allowed}"),
        ));
    };
    let shape = text.get(opening + 1..closing).unwrap_or_default();
    let shape = String::from_utf8_lossy(shape);
    let shape = shape.trim();
    // Python allows a trailing comma, and some programs write it.
    let sizes = shape
        .strip_suffix(',')
        .unwrap_or(shape)
        .split_terminator(',');
    let sizes: Option<Vec<u64>> = sizes.map(|size| size_of(size.trim())).collect();
    let fits = sizes.is_some_and(|sizes| {
        let product = sizes
            .iter()
            .try_fold(1, |product: u64, size| product.checked_mul((*size).max(1)));
        sizes.len() <= MAX_DIMENSIONS && product.is_some()
    });
    if fits {
        Ok(())
    } else {
        let found = shape.chars().take(200).collect();
        Err(HeaderError::Shape { found })
    }
}

fn size_of(text: &str) -> Option<u64> {
    let digits = text.len() <= MAX_DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| text.parse().ok()).flatten()
}
