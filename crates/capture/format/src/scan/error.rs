//! Errors in a file, with their location.

use super::record::RecordLocation;

/// An error at a location of a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ScanError {
    /// The system could not read the file.
    #[error("{place}: cannot read: {source}")]
    Io { place: RecordLocation, source: std::io::Error },
    /// The file has wrong magic bytes at its start.
    #[error("byte 0: found {found}, an MCAP file begins with {:02x?}", mcap::MAGIC)]
    NotMcap {
        /// The kind of file that it is, or its first bytes, at most eight.
        found: String,
    },
    /// The file is truncated.
    #[error("{place}: the file ends within the {what}{}", missing_words(*missing))]
    EndsEarly { place: RecordLocation, what: &'static str, missing: Option<u64> },
    /// An invalid opcode.
    #[error("{place}: found opcode {found:#04x}, records have 0x01 to 0xff")]
    Opcode { place: RecordLocation, found: u8 },
    /// A record with invalid fields.
    #[error("{place}: {what}: {detail}")]
    Record { place: RecordLocation, what: &'static str, detail: String },
    /// A chunk whose head contradicts its length.
    #[error("{place}: chunk: {detail}")]
    ChunkHeader { place: RecordLocation, detail: String },
    /// An unknown compression.
    #[error("{place}: found compression {found:?}, supported are \"\", \"lz4\" and \"zstd\"")]
    Compression { place: RecordLocation, found: String },
    /// The records of a chunk cannot be decompressed.
    #[error("{place}: cannot decompress: {detail}")]
    Decompress { place: RecordLocation, detail: String },
    /// A record exceeds its chunk.
    #[error("{place}: a record of {found} bytes in a chunk that has {left} left")]
    PastChunk { place: RecordLocation, found: u64, left: u64 },
    /// The file has wrong magic bytes at its end.
    #[error("{place}: found {found:02x?}, an MCAP file ends with {:02x?}", mcap::MAGIC)]
    EndMagic { place: RecordLocation, found: Vec<u8> },
    /// Data after the end of the file.
    #[error("{place}: {bytes} bytes follow the end of the file")]
    Trailing { place: RecordLocation, bytes: u64 },
}

fn missing_words(missing: Option<u64>) -> String {
    match missing {
        Some(1) => ", a byte is missing".to_owned(),
        Some(bytes) => format!(", {bytes} bytes are missing"),
        None => String::new(),
    }
}

impl ScanError {
    /// The location.
    pub const fn place(&self) -> RecordLocation {
        match self {
            Self::NotMcap { .. } => RecordLocation::top(0),
            Self::Io { place, .. }
            | Self::EndsEarly { place, .. }
            | Self::Opcode { place, .. }
            | Self::Record { place, .. }
            | Self::ChunkHeader { place, .. }
            | Self::Compression { place, .. }
            | Self::Decompress { place, .. }
            | Self::PastChunk { place, .. }
            | Self::EndMagic { place, .. }
            | Self::Trailing { place, .. } => *place,
        }
    }
}
