//! Fields that the encoding of a state has gained. States of the versions before lack them.

use std::cell::Cell;

use joulebus_energy::{CLASSES, ERRORS, ErrorCounts, GROUPS, Learned, PARTS, SHADOWS};
use serde::{Deserialize, Deserializer};

use crate::layout::lanes::Lanes;

thread_local! {
    /// The version of the state that is decoded. The format names no fields, so a field alone cannot
    /// tell.
    static VERSION: Cell<u8> = const { Cell::new(u8::MAX) };
}

/// The version whose robots keep the shadow forecasts that they have made.
const MADE: u8 = 0x0f;
/// The version whose platforms' errors have groups.
const GROUPED: u8 = 0x10;
/// The version whose groups have the scatter of levels, and whose detectors have no cumulative sums.
const SCATTERED: u8 = 0x11;
/// The version whose groups have levels.
const LEVELLED: u8 = 0x12;

/// Decodes a state of an older version.
pub(crate) fn decode_version<T>(version: u8, decode: impl FnOnce() -> T) -> T {
    VERSION.set(version);
    let decoded = decode();
    VERSION.set(u8::MAX);
    decoded
}

/// Reads a field that versions before `SINCE` lack. It is then the default of its type.
pub(crate) fn read<'de, const SINCE: u8, T, D>(from: D) -> Result<T, D::Error>
where
    T: Deserialize<'de> + Default,
    D: Deserializer<'de>,
{
    if VERSION.get() < SINCE { Ok(T::default()) } else { T::deserialize(from) }
}

/// Reads a field after the two cumulative sums of detectors, which versions before 0x11 have.
pub(crate) fn read_after_cusum<'de, T, D>(from: D) -> Result<T, D::Error>
where
    T: Deserialize<'de>,
    D: Deserializer<'de>,
{
    if VERSION.get() < SCATTERED {
        <([T; 2], T)>::deserialize(from).map(|(_, noise_ratio)| noise_ratio)
    } else {
        T::deserialize(from)
    }
}

/// Reads what robots learn from shadow forecasts. Versions before 0x12 have a group of factors after
/// the third one and at the end of the outlooks', those before 0x0f lack the last two.
pub(crate) fn read_learned<'de, D: Deserializer<'de>>(
    from: D,
) -> Result<[[Lanes<f32>; SHADOWS]; Learned::GROUPS], D::Error> {
    type Group = [Lanes<f32>; SHADOWS];
    let had = |[factor, added, mean, _, trust, last, own, _]: [Group; 8],
               [of, outlook]: [Group; 2]| {
        [factor, added, mean, trust, last, own, of, outlook]
    };
    match VERSION.get() {
        ..MADE => <[Group; 8]>::deserialize(from).map(|groups| had(groups, Default::default())),
        ..LEVELLED => {
            <([Group; 8], [Group; 2])>::deserialize(from).map(|(groups, made)| had(groups, made))
        }
        _ => Deserialize::deserialize(from),
    }
}

/// Reads the errors of a platform. Versions before 0x10 lack what its robots have shown, those
/// before 0x11 the scatter of their levels, and those before 0x12 these levels.
pub(crate) fn read_errors<'de, T, D>(from: D) -> Result<ErrorCounts<T>, D::Error>
where
    T: Deserialize<'de> + Default + Copy,
    D: Deserializer<'de>,
{
    #[derive(Deserialize)]
    struct Before<T> {
        classes: [[T; CLASSES]; ERRORS],
        pulls: [[T; PARTS]; SHADOWS],
    }
    fn before<'de, T, D, const N: usize>(from: D) -> Result<ErrorCounts<T>, D::Error>
    where
        T: Default + Copy,
        D: Deserializer<'de>,
        (Before<T>, [[[T; 2]; N]; GROUPS]): Deserialize<'de>,
    {
        let (Before { classes, pulls }, shown) =
            <(Before<T>, [[[T; 2]; N]; GROUPS])>::deserialize(from)?;
        let all = |had: [[T; 2]; N]| {
            std::array::from_fn(|quantity| had.get(quantity).copied().unwrap_or_default())
        };
        Ok(ErrorCounts { classes, pulls, groups: shown.map(all) })
    }
    match VERSION.get() {
        ..GROUPED => before::<_, _, 0>(from),
        GROUPED => before::<_, _, 3>(from),
        SCATTERED => before::<_, _, 4>(from),
        LEVELLED.. => ErrorCounts::deserialize(from),
    }
}
