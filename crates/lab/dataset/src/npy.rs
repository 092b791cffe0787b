//! The header of NumPy's array files, for recordings and model files alike.
//!
//! A header is untrusted: no allocation depends on a size that it merely claims. It is a Python
//! expression. Only the form that plain arrays have is read, because general parsers nest, multiply
//! and concatenate without bounds.

use std::io::{self, Read};

/// The first bytes of every array file.
pub const MAGIC: &[u8] = b"\x93NUMPY";
/// NumPy's own default limit for a header's length.
const MAX_TEXT_BYTES: usize = 10_000;
/// Maximum number of dimensions, and of digits of each.
const MAX_DIMENSIONS: usize = 8;
const MAX_DIGITS: usize = 9;
/// Bytes of magic and version.
const VERSION_END: usize = 8;

/// Reason that a header could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum HeaderError {
    #[error("the header could not be read: {0}")]
    Io(#[from] io::Error),
    #[error("the header needs {needed} bytes, found {found}")]
    Truncated { needed: usize, found: usize },
    #[error("found no NumPy magic bytes")]
    Magic,
    #[error("{detail}")]
    Malformed { at: usize, detail: String },
    #[error("found records, allowed: plain elements")]
    Records,
    #[error(
        "found shape ({found}), allowed: up to {MAX_DIMENSIONS} dimensions of up to {MAX_DIGITS} \
            digits"
    )]
    Shape { found: String },
}

impl HeaderError {
    /// Offset of the error in the file.
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
    length: usize,
    /// Type of the elements in NumPy's notation, such as `<f4`.
    pub element: String,
    /// True if the first dimension varies fastest (Fortran order).
    pub fortran_order: bool,
    /// Elements in each dimension. Their product fits into 64 bits.
    pub shape: Vec<usize>,
}

impl Header {
    /// Reads the header. The source is then positioned at the first element.
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
                    format!("found format version {major}.{minor}, allowed: 1.0, 2.0 and 3.0");
                return Err(malformed(MAGIC.len(), detail));
            }
        };
        read_until(&mut source, &mut bytes, text_at)?;
        let length = bytes[VERSION_END..].iter().rev();
        let length = length.fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
        if length > MAX_TEXT_BYTES {
            let detail = format!("found a length of {length} bytes, allowed: {MAX_TEXT_BYTES}");
            return Err(malformed(VERSION_END, detail));
        }
        read_until(&mut source, &mut bytes, text_at + length)?;
        let length = bytes.len();
        let (element, fortran_order, shape) = parse(text_at, &bytes[text_at..])?;
        Ok(Self { length, element, fortran_order, shape })
    }

    /// Length of the header in bytes, which is the position of the elements.
    pub fn length(&self) -> usize {
        self.length
    }

    /// The next elements, floats of 4 or 8 bytes, in the order of the file.
    pub(crate) fn floats(&self, source: impl Read, count: usize) -> io::Result<Vec<f64>> {
        match self.element.as_str() {
            "<f4" => elements(source, count, |bytes| f32::from_le_bytes(bytes).into()),
            ">f4" => elements(source, count, |bytes| f32::from_be_bytes(bytes).into()),
            "<f8" => elements(source, count, f64::from_le_bytes),
            ">f8" => elements(source, count, f64::from_be_bytes),
            other => Err(io::Error::other(format!("{other} is no float"))),
        }
    }
}

fn elements<const SIZE: usize>(
    mut source: impl Read,
    mut missing: usize,
    value: impl Fn([u8; SIZE]) -> f64,
) -> io::Result<Vec<f64>> {
    let mut values = Vec::new();
    let mut block = [[0; SIZE]; 1024];
    while missing > 0 {
        let count = missing.min(block.len());
        source.read_exact(block[..count].as_flattened_mut())?;
        values.extend(block[..count].iter().copied().map(&value));
        missing -= count;
    }
    Ok(values)
}

/// The header that NumPy writes for an array in C order. `element` is the type in its notation. The
/// elements begin at a multiple of 64 bytes.
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
        _ => Err(HeaderError::Truncated { needed, found: header.len() }),
    }
}

fn malformed(at: usize, detail: String) -> HeaderError {
    HeaderError::Malformed { at, detail }
}

/// Element type, order and shape. Of Python's expressions only the form below is allowed, its keys
/// in any order.
fn parse(at: usize, text: &[u8]) -> Result<(String, bool, Vec<usize>), HeaderError> {
    if text.contains(&b'[') {
        return Err(HeaderError::Records);
    }
    let found = String::from_utf8_lossy(text);
    let refused = || {
        let found: String = found.trim_end().chars().take(200).collect();
        let allowed = "{'descr': '<f8', 'fortran_order': False, 'shape': (n, 11), }";
        malformed(at, format!("found {found:?}, allowed: {allowed}"))
    };
    let (before, shape, after) = parts(&found).ok_or_else(refused)?;
    // The shape's parentheses stay empty, so that a comma ends a field.
    let fields = format!("{before}(){after}");
    let (mut element, mut fortran_order, mut has_shape) = (None, None, false);
    for field in fields.strip_suffix(',').unwrap_or(&fields).split(',') {
        let (key, value) = field.split_once(':').ok_or_else(refused)?;
        let value = value.trim();
        match (unquoted(key.trim()), value) {
            (Some("descr"), _) if element.is_none() => element = unquoted(value),
            (Some("fortran_order"), "True" | "False") if fortran_order.is_none() => {
                fortran_order = Some(value == "True");
            }
            (Some("shape"), "()") if !has_shape => has_shape = true,
            _ => return Err(refused()),
        }
    }
    let (Some(element), Some(fortran_order), true) = (element, fortran_order, has_shape) else {
        return Err(refused());
    };
    // Python allows a trailing comma, some programs write it, and a single size needs it.
    let sizes: Vec<&str> = match shape.strip_suffix(',') {
        Some(sizes) => sizes.split(',').collect(),
        None if shape.is_empty() => Vec::new(),
        None if shape.contains(',') => shape.split(',').collect(),
        None => return Err(refused()),
    };
    let sizes: Option<Vec<usize>> = sizes.iter().map(|size| size_of(size.trim())).collect();
    let fits = |sizes: &Vec<usize>| {
        let mut sizes = sizes.iter().map(|size| (*size).max(1));
        sizes.len() <= MAX_DIMENSIONS && sizes.try_fold(1, usize::checked_mul).is_some()
    };
    match sizes.filter(fits) {
        Some(shape) => Ok((element.to_owned(), fortran_order, shape)),
        None => {
            let found = shape.chars().take(200).collect();
            Err(HeaderError::Shape { found })
        }
    }
}

/// The text within the braces: before, within and after the parentheses.
fn parts(text: &str) -> Option<(&str, &str, &str)> {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b" \n{}():,'\"<>=|_".contains(&byte);
    if !text.ends_with('\n') || !text.bytes().all(plain) {
        return None;
    }
    let inner = text.trim().strip_prefix('{')?.strip_suffix('}')?;
    let (before, rest) = inner.split_once('(')?;
    let (shape, after) = rest.split_once(')')?;
    let more = [before, shape, after].concat().contains(['{', '}', '(', ')']);
    (!more).then_some((before, shape.trim(), after.trim()))
}

/// A text between quotes of one kind.
fn unquoted(text: &str) -> Option<&str> {
    let inner = |quote| text.strip_prefix(quote)?.strip_suffix(quote);
    let inner = inner('\'').or_else(|| inner('"'))?;
    (!inner.contains(['\'', '"'])).then_some(inner)
}

fn size_of(text: &str) -> Option<usize> {
    let digits = text.len() <= MAX_DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
    let is_number = digits && (text == "0" || !text.starts_with('0'));
    is_number.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use joulebus_testkit::cases;

    use super::*;

    fn read(text: &str) -> Result<Header, HeaderError> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((text.len() as u16 + 1).to_le_bytes());
        bytes.extend(format!("{text}\n").into_bytes());
        Header::read(bytes.as_slice())
    }

    #[test]
    fn one_form_of_python_is_read_its_keys_in_any_order() {
        for case in cases(
            r#"
            {'descr': '<f8', 'fortran_order': False, 'shape': (5, 11), } | <f8 false [5, 11]
            {"shape":(7,),"descr":">f4","fortran_order":True} | >f4 true [7]
            {'shape': ( 2,3 , 4, ), 'fortran_order': False, 'descr': '|O'} | |O false [2, 3, 4]
            {'descr': '|S0', 'fortran_order': False, 'shape': ()} | |S0 false []
            {'descr': '<f8', 'fortran_order': False, 'shape': (0, 0)} | <f8 false [0, 0]
            "#,
        ) {
            let [text, expected] = case.as_slice() else {
                panic!("{case:?}");
            };
            for text in [text.clone(), format!("{text}  ")] {
                let header = read(&text).expect(&text);
                let Header { element, fortran_order, shape, .. } = &header;
                assert_eq!(&format!("{element} {fortran_order} {shape:?}"), expected);
                assert_eq!(header.length(), 10 + text.len() + 1, "{text}");
            }
        }
        let good = "{'descr': '<f8', 'fortran_order': False, 'shape': (5, 11), }";
        for (from, to) in [
            ("(5, 11)", "(5)"),
            ("(5, 11)", "(,)"),
            ("(5, 11)", "(5,, 11)"),
            ("(5, 11)", "(05, 11)"),
            ("(5, 11)", "((5, 11))"),
            ("(5, 11)", "(5, 11)()"),
            ("(5, 11)", "5"),
            ("(5, 11)", "(5, -1)"),
            ("(5, 11)", "(99999999999999,)"),
            ("(5, 11)", "(1 + 1,)"),
            ("'<f8'", "'<f8' '<f8'"),
            ("'<f8'", "'<f8\""),
            ("'<f8'", "u'<f8'"),
            ("'<f8'", "<f8"),
            ("False", "1"),
            ("False", "false"),
            ("'shape'", "'descr'"),
            ("'shape': (5, 11), ", ""),
            ("'descr'", "'more': '', 'descr'"),
            ("{", "({"),
            ("{", "x{"),
            (", }", ",, }"),
        ] {
            let text = good.replace(from, to);
            assert!(read(&text).is_err(), "{text}");
        }
    }
}
