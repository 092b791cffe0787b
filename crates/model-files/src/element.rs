//! The element types of arrays and tensors.

/// An element type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Element {
    F32,
    F64,
    I8,
    I16,
    I32,
    I64,
    U8,
    U16,
    U32,
    U64,
    Bool,
}

/// Element types with NumPy's code, PyTorch's storage class and the name in messages.
const NAMES: [(Element, &str, &str, &str); 11] = [
    (Element::F32, "f4", "FloatStorage", "f32"),
    (Element::F64, "f8", "DoubleStorage", "f64"),
    (Element::I8, "i1", "CharStorage", "i8"),
    (Element::I16, "i2", "ShortStorage", "i16"),
    (Element::I32, "i4", "IntStorage", "i32"),
    (Element::I64, "i8", "LongStorage", "i64"),
    (Element::U8, "u1", "ByteStorage", "u8"),
    (Element::U16, "u2", "UInt16Storage", "u16"),
    (Element::U32, "u4", "UInt32Storage", "u32"),
    (Element::U64, "u8", "UInt64Storage", "u64"),
    (Element::Bool, "b1", "BoolStorage", "bool"),
];

impl Element {
    /// The type with this NumPy code, such as `f4`.
    pub(super) fn from_code(code: &str) -> Option<Element> {
        let known = NAMES.iter().find(|(_, known, ..)| *known == code);
        known.map(|(element, ..)| *element)
    }

    /// The type of this PyTorch storage class, such as `FloatStorage`.
    pub(super) fn from_storage(class: &str) -> Option<Element> {
        let known = NAMES.iter().find(|(_, _, known, _)| *known == class);
        known.map(|(element, ..)| *element)
    }

    /// Name in messages, such as `f32`.
    pub(super) fn name(self) -> &'static str {
        let known = NAMES.iter().find(|(element, ..)| *element == self);
        known.map_or("", |(.., name)| name)
    }

    /// Bytes of one element.
    pub(super) const fn size(self) -> usize {
        match self {
            Element::I8 | Element::U8 | Element::Bool => 1,
            Element::I16 | Element::U16 => 2,
            Element::F32 | Element::I32 | Element::U32 => 4,
            Element::F64 | Element::I64 | Element::U64 => 8,
        }
    }

    /// The element in the first [`size`](Self::size) of `bytes`; NaN if there are fewer. Integers
    /// beyond 2⁵³ are rounded.
    pub(super) fn decode(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut word = [0; 8];
        let Some(bytes) = bytes.get(..self.size()) else {
            return f64::NAN;
        };
        for (place, byte) in word.iter_mut().zip(bytes) {
            *place = *byte;
        }
        if big_endian {
            word[..self.size()].reverse();
        }
        let [a, b, c, d, ..] = word;
        match self {
            Element::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Element::F64 => f64::from_le_bytes(word),
            Element::I8 => f64::from(i8::from_le_bytes([a])),
            Element::I16 => f64::from(i16::from_le_bytes([a, b])),
            Element::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Element::I64 => i64::from_le_bytes(word) as f64,
            Element::U8 => f64::from(a),
            Element::U16 => f64::from(u16::from_le_bytes([a, b])),
            Element::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Element::U64 => u64::from_le_bytes(word) as f64,
            Element::Bool => f64::from(u8::from(a != 0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_decoded_in_both_byte_orders() {
        for (element, bytes, value) in [
            (Element::F32, 1.5_f32.to_le_bytes().to_vec(), 1.5),
            (Element::F64, (-2.25_f64).to_le_bytes().to_vec(), -2.25),
            (Element::I16, (-3_i16).to_le_bytes().to_vec(), -3.0),
            (Element::I64, (-7_i64).to_le_bytes().to_vec(), -7.0),
            (Element::U32, 9_u32.to_le_bytes().to_vec(), 9.0),
            (Element::Bool, vec![2], 1.0),
        ] {
            assert_eq!(element.decode(&bytes, false), value);
            let reversed: Vec<u8> = bytes.iter().rev().copied().collect();
            assert_eq!(element.decode(&reversed, true), value);
            assert!(element.decode(&bytes[..bytes.len() - 1], false).is_nan());
        }
    }
}
