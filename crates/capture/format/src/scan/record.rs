//! Records and their locations.

use std::fmt;

use mcap::records::{ChunkHeader, op};
use serde::Serialize;

/// Maximum length of a record that is read into memory, bytes: a message for a million robots is
/// shorter. A scan skips and reports longer records, and reads longer chunks as a stream. A
/// [`Reader`](crate::Reader) returns an error.
pub const MAX_RECORD_BYTES: u64 = 256 << 20;

/// Decompressed size that is always allowed, bytes.
const FREE_BYTES: u64 = 64 << 20;
/// Decompressed size allowed beyond that per compressed byte, bytes. Captures have about 5.
const MAX_EXPANSION: u64 = 256;

/// Allowed decompressed size of `compressed_bytes`: it bounds the time that a small file can cost
/// its reader.
pub(crate) const fn max_expanded(compressed_bytes: u64) -> u64 {
    FREE_BYTES.saturating_add(compressed_bytes.saturating_mul(MAX_EXPANSION))
}

/// Opcode and length before every record, bytes.
pub(super) const HEAD_BYTES: u64 = 9;
pub(super) const MAGIC_BYTES: u64 = mcap::MAGIC.len() as u64;

/// Location of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct RecordLocation {
    /// Offset of the record, or of its chunk.
    pub offset: u64,
    /// Offset of the record in the decompressed chunk, if it is in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub in_chunk: Option<u64>,
}

impl RecordLocation {
    pub(crate) const fn top(offset: u64) -> Self {
        Self { offset, in_chunk: None }
    }
}

impl fmt::Display for RecordLocation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.in_chunk {
            None => write!(out, "byte {}", self.offset),
            Some(inner) => write!(out, "chunk at byte {}, byte {inner} in it", self.offset),
        }
    }
}

/// A stored checksum and that of the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Crc {
    /// Stored in the file. 0 means none.
    pub saved: u32,
    /// Checksum of the bytes in the file.
    pub found: u32,
}

impl Crc {
    /// True if the two differ.
    pub const fn is_wrong(&self) -> bool {
        self.saved != 0 && self.saved != self.found
    }
}

/// Head and location of a chunk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChunkFrame {
    /// Offset of the chunk's record.
    pub offset: u64,
    /// Length of the whole record with its head, bytes.
    pub bytes: u64,
    /// Its fields.
    pub header: ChunkHeader,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Head {
    pub(super) offset: u64,
    pub(super) opcode: u8,
    pub(super) bytes: u64,
}

impl Head {
    /// The first byte after the record. `None` on overflow.
    pub(super) fn end(self) -> Option<u64> {
        self.offset.checked_add(HEAD_BYTES)?.checked_add(self.bytes)
    }
}

/// 0 is invalid. All others are either known, or reserved for later versions and applications.
pub(crate) const fn is_opcode(opcode: u8) -> bool {
    opcode != 0
}

/// Name of a record kind, for messages.
#[must_use]
pub const fn kind_name(opcode: u8) -> &'static str {
    match opcode {
        op::HEADER => "header",
        op::FOOTER => "footer",
        op::SCHEMA => "schema",
        op::CHANNEL => "channel",
        op::MESSAGE => "message",
        op::CHUNK => "chunk",
        op::MESSAGE_INDEX => "message index",
        op::CHUNK_INDEX => "chunk index",
        op::ATTACHMENT => "attachment",
        op::ATTACHMENT_INDEX => "attachment index",
        op::STATISTICS => "statistics",
        op::METADATA => "metadata",
        op::METADATA_INDEX => "metadata index",
        op::SUMMARY_OFFSET => "summary offset",
        op::DATA_END => "end of data",
        _ => "record of an unknown kind",
    }
}
