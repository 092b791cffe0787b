//! Size limits of files.

/// Maximum number of rows of a trial: 38 hours at 30 Hz.
pub const MAX_ROWS: usize = 1 << 22;
/// Maximum bytes of text in a CSV, after decompression.
pub(super) const MAX_TEXT_BYTES: u64 = 512 << 20;
/// Maximum bytes of text in a row.
pub(super) const MAX_ROW_BYTES: u64 = 1 << 20;
/// Bytes of text that any compressed file may contain.
pub(super) const FREE_TEXT_BYTES: u64 = 16 << 20;
/// Maximum bytes of text per byte of a larger compressed file. Recordings have about 5.
pub(super) const MAX_EXPANSION: u64 = 100;
/// Maximum number of robots in a file.
pub(super) const MAX_ROBOTS: usize = 10_000;

pub(super) const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
/// The first bytes of an MCAP file.
pub(super) const MCAP_MAGIC: &[u8] = b"\x89MCAP0\r\n";
