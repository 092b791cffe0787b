//! What a file may hold at most, and how its kind is told.

/// Most rows that a trial may have: 38 hours at 30 Hz.
pub const MAX_ROWS: usize = 1 << 22;
/// Most bytes of text that a CSV may hold, after decompression.
pub(super) const MAX_TEXT_BYTES: u64 = 512 << 20;
/// Most robots that a file may hold.
pub(super) const MAX_ROBOTS: usize = 10_000;

pub(super) const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
pub(super) const ZIP_MAGIC: &[u8] = b"PK\x03\x04";
