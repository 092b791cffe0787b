//! The element types of arrays and tensors.

/// An element type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Element {
    F16,
    /// The upper half of an f32.
    BF16,
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

/// Element types with NumPy's code (`-`: it has none), PyTorch's storage class and the name in
/// messages.
const NAMES: [(Element, &str, &str, &str); 13] = [
    (Element::F16, "f2", "HalfStorage", "f16"),
    (Element::BF16, "-", "BFloat16Storage", "bf16"),
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

    /// Size of one element, bytes.
    pub(super) const fn size(self) -> usize {
        match self {
            Element::I8 | Element::U8 | Element::Bool => 1,
            Element::F16 | Element::BF16 | Element::I16 | Element::U16 => 2,
            Element::F32 | Element::I32 | Element::U32 => 4,
            Element::F64 | Element::I64 | Element::U64 => 8,
        }
    }

    /// The element in the first [`size`](Self::size) of `bytes`, NaN if there are fewer. Integers
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
            Element::F16 => half(u16::from_le_bytes([a, b])),
            Element::BF16 => f64::from(f32::from_le_bytes([0, 0, a, b])),
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

/// An IEEE 754 half: a sign, five bits of exponent, ten of fraction.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    let magnitude = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction > 0.0 => f64::NAN,
        31 => f64::INFINITY,
        _ => (1024.0 + fraction) * 2f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -magnitude } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_of_both_kinds_are_exact() {
        for (bits, value) in [
            (0x0000, 0.0),
            (0x0001, 2f64.powi(-24)),
            (0x03ff, 1023.0 * 2f64.powi(-24)),
            (0x0400, 2f64.powi(-14)),
            (0x3c00, 1.0),
            (0x3c01, 1.0 + 2f64.powi(-10)),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x7c00, f64::INFINITY),
        ] {
            assert_eq!(half(bits), value, "{bits:04x}");
        }
        assert!(half(0x7e00).is_nan());
        let bf16 = |bits: u16| Element::BF16.decode(&bits.to_le_bytes(), false);
        assert_eq!((bf16(0x3f80), bf16(0xc049)), (1.0, -3.140625));
    }

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
