//! Checksums of an archive's files.

use std::fmt;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;

use crc32fast::Hasher;

/// Bytes that are read at once.
const BLOCK_BYTES: usize = 1 << 17;

/// Number of bytes before the footer, and the CRC-32 of those bytes and of the text of the
/// [`Head`](super::Head). Parquet has checksums of pages, but the crate does not write them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sum {
    pub(super) bytes: u64,
    pub(super) crc32: u32,
}

impl Sum {
    pub(super) fn new(bytes: u64, mut crc: Hasher, head: &str) -> Self {
        crc.update(head.as_bytes());
        Self { bytes, crc32: crc.finalize() }
    }

    pub(super) fn parse(text: &str) -> Option<Self> {
        let (bytes, crc32) = text.split_once(' ')?;
        Some(Self { bytes: bytes.parse().ok()?, crc32: u32::from_str_radix(crc32, 16).ok()? })
    }
}

impl fmt::Display for Sum {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} {:08x}", self.bytes, self.crc32)
    }
}

/// The first `max_bytes` of a file, or as many as it has, and their CRC-32.
pub(super) fn beginning(file: &File, max_bytes: u64) -> io::Result<(u64, Hasher)> {
    let (mut crc, mut bytes) = (Hasher::new(), 0);
    let mut block = vec![0; BLOCK_BYTES];
    while bytes < max_bytes {
        let left = usize::try_from(max_bytes - bytes).unwrap_or(BLOCK_BYTES);
        let wanted = &mut block[..left.min(BLOCK_BYTES)];
        match file.read_at(wanted, bytes)? {
            0 => break,
            read => {
                crc.update(&wanted[..read]);
                bytes += read as u64;
            }
        }
    }
    Ok((bytes, crc))
}
