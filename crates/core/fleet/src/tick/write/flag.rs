//! Flags of payloads.

/// `flag` if `holds`, else 0.
pub(crate) const fn flag(holds: bool, flag: u32) -> u32 {
    if holds { flag } else { 0 }
}
