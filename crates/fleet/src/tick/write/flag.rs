//! Flags of payloads.

/// The flag, if it holds.
pub(crate) const fn flag(holds: bool, flag: u32) -> u32 {
    if holds { flag } else { 0 }
}
