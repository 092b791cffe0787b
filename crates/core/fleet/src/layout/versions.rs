//! Fields that the encoding of a state has gained, lost, or stores otherwise. States of the versions
//! before are converted.

use std::cell::Cell;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};

use crate::layout::lanes::Lanes;

thread_local! {
    /// The version of the state that is decoded. The format names no fields, so a field alone cannot
    /// tell.
    static VERSION: Cell<u8> = const { Cell::new(u8::MAX) };
}

/// The version that gained the fields of [`read`], and whose groups have levels.
pub(crate) const READ: u8 = 0x12;
/// The version that stores in fewer bytes what needs no more, and forgot the scatter of levels.
pub(crate) const NARROW: u8 = 0x13;

/// True if the state that is decoded is of an older version than `since`.
pub(crate) fn is_before(since: u8) -> bool {
    VERSION.get() < since
}

/// Decodes a state of an older version.
pub(crate) fn decode_version<T>(version: u8, decode: impl FnOnce() -> T) -> T {
    VERSION.set(version);
    let decoded = decode();
    VERSION.set(u8::MAX);
    decoded
}

/// Reads a field that versions before 0x12 lack. It is then the default of its type.
pub(crate) fn read<'de, T, D>(from: D) -> Result<T, D::Error>
where
    T: Deserialize<'de> + Default,
    D: Deserializer<'de>,
{
    if is_before(READ) { Ok(T::default()) } else { T::deserialize(from) }
}

/// A number of a robot, or a column of them, that is stored in half as many bytes since 0x13.
///
/// Outside of columns it is stored as it was.
pub(crate) trait Narrow: DeserializeOwned {
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Self::deserialize(from)
    }
}

/// A departed robot's.
impl Narrow for f64 {}

impl Narrow for Lanes<f32> {
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        before(NARROW, from, |wide: Lanes<f64>| wide.map(|number| number as f32))
    }
}

/// A detector's, which is in no state by itself.
impl Narrow for u32 {}

impl Narrow for Lanes<u16> {
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        // Bits of alarms above those that are stored were never set.
        before(NARROW, from, |wide: Lanes<u32>| wide.map(|bits| bits as u16))
    }
}

/// Reads a number that is [`Narrow`].
pub(crate) fn read_narrow<'de, T: Narrow, D: Deserializer<'de>>(from: D) -> Result<T, D::Error> {
    T::read(from)
}

/// Reads a field that versions before `since` have as another type.
pub(crate) fn before<'de, Old, New, D>(
    since: u8,
    from: D,
    convert: impl FnOnce(Old) -> New,
) -> Result<New, D::Error>
where
    Old: Deserialize<'de>,
    New: Deserialize<'de>,
    D: Deserializer<'de>,
{
    if is_before(since) { Old::deserialize(from).map(convert) } else { New::deserialize(from) }
}
