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
}

/// Reads the header; `name` locates the file in messages.
pub(super) fn header(name: &str, bytes: &[u8]) -> Result<(Header, ElementType), ReadError> {
    let bad = |at: usize, detail: String| ReadError::Part {
        container: Container::Npy,
        part: format!("{name}header, byte {at}"),
        detail,
    };
    let header = Header::read(bytes).map_err(|error| bad(error.at(), error.to_string()))?;
    let kind = kind(&header.element).ok_or_else(|| {
        let allowed = "numbers, bytes of text and objects";
        let detail = format!(
            "found element type {:?}, allowed: {allowed}",
            header.element
        );
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
    match kind {
        ElementType::Numbers(element) => {
            let big_endian = header.element.starts_with('>');
            let tensor = Tensor::dense(shape, element, contents, big_endian, header.fortran_order);
            Ok(EntryValue::Tensor(tensor))
        }
        _ => match std::str::from_utf8(contents) {
            Ok(text) => Ok(EntryValue::Text(text.trim_end_matches('\0').to_owned())),
            Err(error) => Err(bad(format!("found text that is not UTF-8: {error}"))),
        },
    }
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
