//! NumPy's array files: arrays of numbers, and single texts. [`pickle`](super::pickle) reads
//! objects.

use joulebus_dataset::npy::Header;

use super::element::Element;
use super::pickle::product;
use super::{Container, EntryValue, ReadError, Tensor};

/// Element type of an array.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ElementType {
    Numbers(Element),
    /// A pickle.
    Objects,
    /// Text of this many bytes per element.
    Text(usize),
    /// Text of this many code points of four bytes per element.
    Unicode(usize),
}

/// Reads the header. `name` locates the file in messages.
pub(super) fn header(name: &str, bytes: &[u8]) -> Result<(Header, ElementType), ReadError> {
    let bad = |at: usize, detail: String| ReadError::Part {
        container: Container::Npy,
        part: format!("{name}header, byte {at}"),
        detail,
    };
    let header = Header::read(bytes).map_err(|error| bad(error.at(), error.to_string()))?;
    let kind = kind(&header.element).ok_or_else(|| {
        let allowed = "numbers, bytes of text and objects";
        let detail = format!("found element type {:?}, allowed: {allowed}", header.element);
        bad(0, detail)
    })?;
    Ok((header, kind))
}

/// The element type of a NumPy type string.
fn kind(descr: &str) -> Option<ElementType> {
    if descr == "|O" {
        return Some(ElementType::Objects);
    }
    if let Some(length) = descr.strip_prefix("|S") {
        return length.parse().ok().map(ElementType::Text);
    }
    let code = descr.strip_prefix(['<', '>', '|'])?;
    if let Some(length) = code.strip_prefix('U') {
        let length: usize = length.parse().ok()?;
        return Some(ElementType::Unicode(length.checked_mul(4)?));
    }
    Element::from_code(code).map(ElementType::Numbers)
}

/// An array of numbers, or a single text.
pub(super) fn value(name: &str, bytes: &[u8]) -> Result<EntryValue, ReadError> {
    let (header, kind) = header(name, bytes)?;
    let contents = &bytes[header.length()..];
    let bad = |detail: String| ReadError::Part {
        container: Container::Npy,
        part: format!("{name}contents, byte {}", header.length()),
        detail,
    };
    let shape = header.shape.clone();
    let (size, what) = match kind {
        ElementType::Numbers(element) => (element.size(), element.name()),
        ElementType::Text(length) | ElementType::Unicode(length) => (length, "text"),
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
    let big_endian = header.element.starts_with('>');
    let text = match kind {
        ElementType::Numbers(element) => {
            let tensor = Tensor::dense(shape, element, contents, big_endian, header.fortran_order);
            return Ok(EntryValue::Tensor(tensor));
        }
        _ if !shape.is_empty() => return Ok(EntryValue::Other("an array of texts")),
        ElementType::Unicode(_) => code_points(contents, big_endian),
        _ => std::str::from_utf8(contents).map(str::to_owned).map_err(|error| error.to_string()),
    };
    match text {
        Ok(text) => Ok(EntryValue::Text(text.trim_end_matches('\0').to_owned())),
        Err(error) => Err(bad(format!("found text that is not Unicode: {error}"))),
    }
}

/// Text of four bytes per code point.
fn code_points(contents: &[u8], big_endian: bool) -> Result<String, String> {
    let (words, _) = contents.as_chunks::<4>();
    let character = |word: &[u8; 4]| {
        let code = match big_endian {
            true => u32::from_be_bytes(*word),
            false => u32::from_le_bytes(*word),
        };
        char::from_u32(code).ok_or_else(|| format!("code point {code:#x}"))
    };
    words.iter().map(character).collect()
}

/// An array file in NumPy's format. `element` is the type and `contents` its bytes.
pub(super) fn write(element: &str, shape: &[usize], contents: &[u8]) -> Vec<u8> {
    let mut bytes = joulebus_dataset::npy::header(element, shape);
    bytes.extend(contents);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_arrays_can_be_read() {
        let values = [1.5_f32, -2.0, 0.25, 4.0, 5.0, 6.0];
        let contents: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
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
        let unicode = |code: &str, swap: bool| {
            let words = "tanh".chars().map(|c| c as u32);
            let bytes = words.flat_map(|word| match swap {
                true => word.to_be_bytes(),
                false => word.to_le_bytes(),
            });
            value("", &write(code, &[], &bytes.collect::<Vec<u8>>())).expect("whole")
        };
        assert_eq!(unicode("<U4", false), EntryValue::Text("tanh".to_owned()));
        assert_eq!(unicode(">U4", true), EntryValue::Text("tanh".to_owned()));
        let several = value("", &write("|S2", &[2], b"abcd")).expect("whole");
        assert_eq!(several, EntryValue::Other("an array of texts"));
    }

    #[test]
    fn elements_that_are_no_numbers_texts_or_objects_are_refused() {
        let read = |element| header("", &write(element, &[1], &[])).is_ok();
        assert!(read("<f4"));
        assert!(!["<c8", "<M8[s]"].into_iter().any(read));
    }
}
