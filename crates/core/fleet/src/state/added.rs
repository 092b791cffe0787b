//! Fields that the encoding of a state has gained. States of the versions before lack them.

use std::cell::Cell;

use joulebus_energy::{CLASSES, ERRORS, ErrorCounts, GROUPS, Learned, PARTS, SHADOWS, SHOWN};
use serde::{Deserialize, Deserializer};

use crate::layout::lanes::Lanes;

thread_local! {
    /// The version of the state that is decoded. The format names no fields, so a field alone cannot
    /// tell.
    static VERSION: Cell<u8> = const { Cell::new(u8::MAX) };
}

/// The version that gained the fields of [`read`], and whose groups have levels.
const READ: u8 = 0x12;

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
    if VERSION.get() < READ { Ok(T::default()) } else { T::deserialize(from) }
}

/// Reads what robots learn from shadow forecasts. Versions before 0x12 have two groups of factors
/// more.
pub(crate) fn read_learned<'de, D: Deserializer<'de>>(
    from: D,
) -> Result<[[Lanes<f32>; SHADOWS]; Learned::GROUPS], D::Error> {
    type Group = [Lanes<f32>; SHADOWS];
    if VERSION.get() >= READ {
        return Deserialize::deserialize(from);
    }
    let [factor, added, mean, _, trust, last, own, _, of, outlook] =
        <[Group; 10]>::deserialize(from)?;
    Ok([factor, added, mean, trust, last, own, of, outlook])
}

/// Reads the errors of a platform. Versions before 0x12 lack the levels that its robots have shown.
pub(crate) fn read_errors<'de, T, D>(from: D) -> Result<ErrorCounts<T>, D::Error>
where
    T: Deserialize<'de> + Default + Copy,
    D: Deserializer<'de>,
{
    #[derive(Deserialize)]
    struct Before<T> {
        classes: [[T; CLASSES]; ERRORS],
        pulls: [[T; PARTS]; SHADOWS],
        groups: [[[T; 2]; SHOWN - 1]; GROUPS],
    }
    if VERSION.get() >= READ {
        return ErrorCounts::deserialize(from);
    }
    let Before { classes, pulls, groups } = Before::deserialize(from)?;
    let all = |had: [[T; 2]; SHOWN - 1]| {
        std::array::from_fn(|quantity| had.get(quantity).copied().unwrap_or_default())
    };
    Ok(ErrorCounts { classes, pulls, groups: groups.map(all) })
}
