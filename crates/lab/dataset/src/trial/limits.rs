//! Size limits of files.

/// Rows of a file in memory when it is read in parts: 38 hours of a robot at 30 Hz. A shorter file
/// is not divided.
pub const MAX_ROWS: usize = 1 << 22;
/// Maximum number of rows of a file that is read whole: some 2 GB of memory.
pub(super) const MAX_WHOLE_ROWS: usize = 1 << 24;
/// Rows of a file that its rows' numbers allow.
pub(super) const MAX_FILE_ROWS: usize = u32::MAX as usize;
/// Maximum bytes of text in a CSV, after decompression.
pub(super) const MAX_TEXT_BYTES: u64 = 64 << 30;
pub(super) const MAX_ROW_BYTES: u64 = 1 << 20;
/// Bytes of text that any compressed file may contain.
pub(super) const FREE_TEXT_BYTES: u64 = 16 << 20;
/// Maximum bytes of text per byte of a larger compressed file. Recordings have about 5.
pub(super) const MAX_EXPANSION: u64 = 100;
pub(super) const MAX_ROBOTS: usize = 10_000;

/// Part of a file that is in memory at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct InMemory {
    /// Rows after which a part is complete.
    pub(super) part_rows: usize,
    pub(super) max_rows: usize,
}

impl InMemory {
    pub(super) const WHOLE: Self = Self { part_rows: usize::MAX, max_rows: MAX_WHOLE_ROWS };

    /// Parts of it, one after another.
    pub(super) const fn parts(part_rows: usize) -> Self {
        Self { part_rows, max_rows: MAX_FILE_ROWS }
    }
}

pub(super) const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
pub(super) const MCAP_MAGIC: &[u8] = b"\x89MCAP0\r\n";
