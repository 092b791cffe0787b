//! Fields that the encoding of a state has gained. States of the version before lack them.

use std::cell::Cell;

use serde::{Deserialize, Deserializer};

thread_local! {
    /// True while a state of the version before is decoded. The format names no fields, so a field
    /// alone cannot tell.
    static IS_BEFORE: Cell<bool> = const { Cell::new(false) };
}

/// Decodes a state of the version before.
pub(super) fn decode_before<T>(decode: impl FnOnce() -> T) -> T {
    IS_BEFORE.set(true);
    let decoded = decode();
    IS_BEFORE.set(false);
    decoded
}

/// Reads a field that the version before lacks. It is then the default of its type.
pub(crate) fn read<'de, T, D>(from: D) -> Result<T, D::Error>
where
    T: Deserialize<'de> + Default,
    D: Deserializer<'de>,
{
    if IS_BEFORE.get() { Ok(T::default()) } else { T::deserialize(from) }
}
