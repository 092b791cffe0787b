//! A palette for all kinds of colour vision, on light and dark backgrounds.

use serde::{Serialize, Serializer};

/// Meaning of a colour. The hues are those of Okabe and Ito (2008), which stay distinct under the
/// common colour vision deficiencies. Adjacent marks also differ in shape or dash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Text and readings.
    Ink,
    /// Axes, and marks in the background.
    Grey,
    /// Grid lines.
    Faint,
    /// The network.
    Blue,
    /// Persistence.
    Orange,
    /// AR(5) with velocities.
    Green,
    /// Numbers of the paper.
    Vermilion,
    /// A second network, or a further baseline.
    Purple,
    /// A further baseline.
    Sky,
}

impl Serialize for Colour {
    /// Writes `#RRGGBB`, the colour on a light background.
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&Self::hex(self.light()))
    }
}

impl Colour {
    /// Every colour.
    pub const ALL: [Self; 9] = [
        Self::Ink,
        Self::Grey,
        Self::Faint,
        Self::Blue,
        Self::Orange,
        Self::Green,
        Self::Vermilion,
        Self::Purple,
        Self::Sky,
    ];

    /// Red, green and blue on a light background.
    pub const fn light(self) -> [u8; 3] {
        match self {
            Self::Ink => [0x1B, 0x1F, 0x24],
            Self::Grey => [0x6E, 0x77, 0x81],
            Self::Faint => [0xE4, 0xE7, 0xEB],
            Self::Blue => [0x00, 0x72, 0xB2],
            Self::Orange => [0xE6, 0x9F, 0x00],
            Self::Green => [0x00, 0x9E, 0x73],
            Self::Vermilion => [0xD5, 0x5E, 0x00],
            Self::Purple => [0xAA, 0x44, 0x99],
            Self::Sky => [0x56, 0xB4, 0xE9],
        }
    }

    /// Red, green and blue on a dark background.
    pub const fn dark(self) -> [u8; 3] {
        match self {
            Self::Ink => [0xE6, 0xE9, 0xED],
            Self::Grey => [0x9A, 0xA4, 0xAF],
            Self::Faint => [0x33, 0x3A, 0x42],
            Self::Blue => [0x4F, 0xA8, 0xE0],
            Self::Orange => [0xF0, 0xB4, 0x29],
            Self::Green => [0x2C, 0xC3, 0x97],
            Self::Vermilion => [0xF0, 0x80, 0x30],
            Self::Purple => [0xD0, 0x7B, 0xC2],
            Self::Sky => [0x8C, 0xCF, 0xF5],
        }
    }

    /// Formats a colour as `#RRGGBB`, the notation in the drawings.
    pub fn hex([red, green, blue]: [u8; 3]) -> String {
        format!("#{red:02X}{green:02X}{blue:02X}")
    }
}
