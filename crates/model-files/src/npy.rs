//! NumPy's array files: the header, and arrays of numbers. Objects are [`pickle`](super::pickle)'s.

use super::element::Element;
use super::pickle::product;
use super::{Container, EntryValue, ReadError, Tensor};

pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// NumPy itself reads no longer header unless told to.
const MAX_HEADER_BYTES: usize = 10_000;
const ALIGNMENT: usize = 64;

/// What an array is made of.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ElementType {
    Numbers(Element),
    /// A pickle.
    Objects,
    /// Bytes of text, so many an element.
    Text(usize),
}

/// What the header says.
pub(super) struct Header {
    pub(super) kind: ElementType,
    pub(super) big_endian: bool,
    pub(super) fortran_order: bool,
    pub(super) shape: Vec<usize>,
    /// Where the contents begin.
    pub(super) end: usize,
}

/// Reads the header; `name` is the file's place in messages.
pub(super) fn header(name: &str, bytes: &[u8]) -> Result<Header, ReadError> {
    let bad = |at: usize, detail: String| ReadError::Part {
        container: Container::Npy,
        part: format!("{name}header, byte {at}"),
        detail,
    };
    let ends = || bad(bytes.len(), "the file ends here".to_owned());
    if !bytes.starts_with(MAGIC) {
        return Err(bad(0, "found no NumPy array".to_owned()));
    }
    let length_bytes = match bytes.get(6).ok_or_else(ends)? {
        1 => 2,
        2 | 3 => 4,
        version => {
            let detail = format!("found format version {version}, allowed: 1 to 3");
            return Err(bad(6, detail));
        }
    };
    if bytes.get(7).ok_or_else(ends)? != &0 {
        let detail = format!("found minor version {}, allowed: 0", bytes[7]);
        return Err(bad(7, detail));
    }
    let start = 8 + length_bytes;
    let length = bytes.get(8..start).ok_or_else(ends)?.iter().rev();
    let length = length.fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
    if length > MAX_HEADER_BYTES {
        let detail = format!("found a length of {length}, allowed: {MAX_HEADER_BYTES}");
        return Err(bad(8, detail));
    }
    let end = start + length;
    let text = bytes.get(start..end).ok_or_else(ends)?;
    let text = String::from_utf8_lossy(text);
    let parsed = parse(&text);
    let (descr, fortran_order, shape) = parsed.ok_or_else(|| {
        let found: String = text.trim_end().chars().take(200).collect();
        let allowed = "{'descr': '<f4', 'fortran_order': False, 'shape': (64, 11), }";
        bad(start, format!("found {found:?}, allowed: {allowed}"))
    })?;
    let kind = kind(descr).ok_or_else(|| {
        let found: String = descr.chars().take(50).collect();
        let allowed = "numbers, bytes of text and objects";
        bad(
            start,
            format!("found element type {found:?}, allowed: {allowed}"),
        )
    })?;
    Ok(Header {
        kind,
        big_endian: descr.starts_with('>'),
        fortran_order,
        shape,
        end,
    })
}

/// The element type that NumPy writes so.
fn kind(descr: &str) -> Option<ElementType> {
    if descr == "|O" {
        return Some(ElementType::Objects);
    }
    if let Some(length) = descr.strip_prefix("|S") {
        return size(length).map(ElementType::Text);
    }
    let code = descr.strip_prefix(['<', '>', '|'])?;
    Element::from_code(code).map(ElementType::Numbers)
}

/// Element type, order and shape, if the text is written as NumPy writes it.
fn parse(text: &str) -> Option<(&str, bool, Vec<usize>)> {
    let rest = text.strip_prefix("{'descr': '")?;
    let (descr, rest) = rest.split_once("', 'fortran_order': ")?;
    let (fortran_order, rest) = rest.split_once(", 'shape': (")?;
    let fortran_order = match fortran_order {
        "True" => true,
        "False" => false,
        _ => return None,
    };
    let (sizes, rest) = rest.split_once(')')?;
    if rest.strip_suffix('\n')?.trim_end_matches(' ') != ", }" {
        return None;
    }
    let sizes = sizes.strip_suffix(',').unwrap_or(sizes);
    let shape: Option<Vec<usize>> = match sizes {
        "" => Some(Vec::new()),
        _ => sizes.split(", ").map(size).collect(),
    };
    shape
        .filter(|shape| shape.len() <= 8)
        .map(|shape| (descr, fortran_order, shape))
}

fn size(text: &str) -> Option<usize> {
    let digits = text.len() <= 9 && text.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| text.parse().ok()).flatten()
}

/// An array of numbers, or a single text.
pub(super) fn value(name: &str, bytes: &[u8]) -> Result<EntryValue, ReadError> {
    let header = header(name, bytes)?;
    let contents = &bytes[header.end..];
    let bad = |detail: String| ReadError::Part {
        container: Container::Npy,
        part: format!("{name}contents, byte {}", header.end),
        detail,
    };
    let shape = header.shape;
    let (size, what) = match header.kind {
        ElementType::Numbers(element) => (element.size(), element.name()),
        ElementType::Text(length) if shape.is_empty() => (length, "text"),
        ElementType::Text(_) => {
            return Err(bad("found an array of texts, allowed: one text".to_owned()));
        }
        ElementType::Objects => {
            return Err(bad("found objects, allowed: numbers and text".to_owned()));
        }
    };
    let needed = product(&shape).and_then(|count| count.checked_mul(size));
    if needed != Some(contents.len()) {
        let needed = needed.map_or("far more".to_owned(), |needed| needed.to_string());
        let found = contents.len();
        let detail = format!("found {found} bytes, the shape {shape:?} of {what} needs {needed}");
        return Err(bad(detail));
    }
    match header.kind {
        ElementType::Numbers(element) => {
            let (big_endian, fortran_order) = (header.big_endian, header.fortran_order);
            let tensor = Tensor::dense(shape, element, contents, big_endian, fortran_order);
            Ok(EntryValue::Tensor(tensor))
        }
        _ => match std::str::from_utf8(contents) {
            Ok(text) => Ok(EntryValue::Text(text.trim_end_matches('\0').to_owned())),
            Err(error) => Err(bad(format!("found text that is not UTF-8: {error}"))),
        },
    }
}

/// An array file as NumPy writes it. `descr` is the element type and `contents` its bytes.
pub(super) fn write(descr: &str, shape: &[usize], contents: &[u8]) -> Vec<u8> {
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let sizes = sizes.join(", ");
    let mut text =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({sizes}{comma}), }}");
    let before = MAGIC.len() + 4;
    let filled = (before + text.len() + 1).next_multiple_of(ALIGNMENT);
    while before + text.len() + 1 < filled {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    // The header is a line with a few sizes: far below 64 KiB.
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.bytes());
    bytes.extend(contents);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let values = [1.5_f32, -2.0, 0.25, 4.0, 5.0, 6.0];
        let contents: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        for shape in [vec![2, 3], vec![6], vec![1, 6, 1]] {
            let bytes = write("<f4", &shape, &contents);
            let EntryValue::Tensor(tensor) = value("", &bytes).expect("whole") else {
                panic!("numbers")
            };
            assert_eq!(tensor.shape(), shape);
            assert_eq!(tensor.values(), values.map(f64::from));
        }
        let text = value("", &write("|S6", &[], "größe".as_bytes()[..6].as_ref()));
        assert_eq!(text.expect("whole"), EntryValue::Text("größ".to_owned()));
    }

    #[test]
    fn headers_that_numpy_does_not_write_are_refused() {
        let with = |text: &str| {
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((text.len() as u16).to_le_bytes());
            bytes.extend(text.bytes());
            header("", &bytes)
        };
        let good = "{'descr': '<f4', 'fortran_order': False, 'shape': (1,), }\n";
        assert!(with(good).is_ok());
        for (from, to) in [
            ("(1,)", "(1, -1)"),
            ("(1,)", "(99999999999999,)"),
            ("(1,)", "(1 + 1,)"),
            ("<f4", "<c8"),
            ("<f4", "<U9"),
            ("False", "0"),
            ("}\n", "}"),
            ("}\n", "__import__('os') }\n"),
        ] {
            assert!(with(&good.replace(from, to)).is_err(), "{from} as {to}");
        }
    }
}
