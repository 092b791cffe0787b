//! What may be wrong with a file, and where.

use super::record::Place;

/// Why a file cannot be read on from a place.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScanError {
    /// The system could not read.
    #[error("{place}: cannot read: {source}")]
    Io {
        /// Where.
        place: Place,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file begins with other bytes than every MCAP file.
    #[error(
        "byte 0: found {found:02x?}, an MCAP file begins with {:02x?}",
        mcap::MAGIC
    )]
    NotMcap {
        /// Its first bytes, at most eight.
        found: Vec<u8>,
    },
    /// The file ends within something.
    #[error("{place}: the file ends within the {what}{}", missing_words(*missing))]
    EndsEarly {
        /// Where the thing begins that is cut off.
        place: Place,
        /// What is cut off.
        what: &'static str,
        /// Bytes that are missing, if that can be told.
        missing: Option<u64>,
    },
    /// An opcode that no record has.
    #[error("{place}: found opcode {found:#04x}; records have 0x01 to 0xff")]
    Opcode {
        /// Where.
        place: Place,
        /// The byte found.
        found: u8,
    },
    /// A record whose fields cannot be read.
    #[error("{place}: {what}: {detail}")]
    Record {
        /// Where it stands.
        place: Place,
        /// Its kind.
        what: &'static str,
        /// What is wrong with it.
        detail: String,
    },
    /// A chunk whose head does not fit its length.
    #[error("{place}: chunk: {detail}")]
    ChunkHeader {
        /// Where it stands.
        place: Place,
        /// What is wrong with it.
        detail: String,
    },
    /// A compression that this program does not know.
    #[error("{place}: found compression {found:?}; known are \"\", \"lz4\" and \"zstd\"")]
    Compression {
        /// Where the chunk stands.
        place: Place,
        /// Its name in the file.
        found: String,
    },
    /// The records of a chunk cannot be decompressed.
    #[error("{place}: cannot decompress: {detail}")]
    Decompress {
        /// Up to where it could be.
        place: Place,
        /// What the decompressor said.
        detail: String,
    },
    /// A record runs past its chunk.
    #[error("{place}: a record of {found} bytes in a chunk that has {left} left")]
    PastChunk {
        /// Where the record stands.
        place: Place,
        /// Its length, bytes.
        found: u64,
        /// What the chunk has left, bytes.
        left: u64,
    },
    /// The file does not end as every MCAP file.
    #[error(
        "{place}: found {found:02x?}, an MCAP file ends with {:02x?}",
        mcap::MAGIC
    )]
    EndMagic {
        /// Where.
        place: Place,
        /// The bytes found, at most eight.
        found: Vec<u8>,
    },
    /// Something follows the end of the file.
    #[error("{place}: {bytes} bytes follow the end of the file")]
    Trailing {
        /// Where they begin.
        place: Place,
        /// How many.
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
    /// Where it is.
    #[must_use]
    pub const fn place(&self) -> Place {
        match self {
            Self::NotMcap { .. } => Place::top(0),
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
