//! Errors in a file, with their location.

use super::record::RecordLocation;

/// An error at a location of a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScanError {
    /// The system could not read the file.
    #[error("{place}: cannot read: {source}")]
    Io {
        /// The location.
        place: RecordLocation,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The file has wrong magic bytes at its start.
    #[error("byte 0: found {found}, an MCAP file begins with {:02x?}", mcap::MAGIC)]
    NotMcap {
        /// The kind of file that it is, or its first bytes, at most eight.
        found: String,
    },
    /// The file is truncated.
    #[error("{place}: the file ends within the {what}{}", missing_words(*missing))]
    EndsEarly {
        /// Start of the truncated element.
        place: RecordLocation,
        /// The truncated element.
        what: &'static str,
        /// Number of missing bytes, if known.
        missing: Option<u64>,
    },
    /// An invalid opcode.
    #[error("{place}: found opcode {found:#04x}, records have 0x01 to 0xff")]
    Opcode {
        /// The location.
        place: RecordLocation,
        /// The byte found.
        found: u8,
    },
    /// A record with invalid fields.
    #[error("{place}: {what}: {detail}")]
    Record {
        /// Its location.
        place: RecordLocation,
        /// Its kind.
        what: &'static str,
        /// The error.
        detail: String,
    },
    /// A chunk whose head contradicts its length.
    #[error("{place}: chunk: {detail}")]
    ChunkHeader {
        /// Its location.
        place: RecordLocation,
        /// The error.
        detail: String,
    },
    /// An unknown compression.
    #[error("{place}: found compression {found:?}, supported are \"\", \"lz4\" and \"zstd\"")]
    Compression {
        /// Location of the chunk.
        place: RecordLocation,
        /// Its name in the file.
        found: String,
    },
    /// The records of a chunk cannot be decompressed.
    #[error("{place}: cannot decompress: {detail}")]
    Decompress {
        /// Position up to which it was decompressed.
        place: RecordLocation,
        /// The decompressor's error.
        detail: String,
    },
    /// A record exceeds its chunk.
    #[error("{place}: a record of {found} bytes in a chunk that has {left} left")]
    PastChunk {
        /// Location of the record.
        place: RecordLocation,
        /// Its length, bytes.
        found: u64,
        /// Bytes left in the chunk.
        left: u64,
    },
    /// The file has wrong magic bytes at its end.
    #[error("{place}: found {found:02x?}, an MCAP file ends with {:02x?}", mcap::MAGIC)]
    EndMagic {
        /// The location.
        place: RecordLocation,
        /// The bytes found, at most eight.
        found: Vec<u8>,
    },
    /// Data after the end of the file.
    #[error("{place}: {bytes} bytes follow the end of the file")]
    Trailing {
        /// Its location.
        place: RecordLocation,
        /// Its length.
        bytes: u64,
    },
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
    #[must_use]
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
