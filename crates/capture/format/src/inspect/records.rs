//! Chunks, schemas, attachments and metadata records of a file.

use std::collections::BTreeMap;

use serde::Serialize;

/// The chunks of one compression.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct CompressionReport {
    /// `zstd`, `lz4`, or empty.
    pub compression: String,
    /// Number of chunks.
    pub chunks: u64,
    /// Size of their records in the file, bytes.
    pub compressed_bytes: u64,
    /// Size of their records decompressed, bytes.
    pub uncompressed_bytes: u64,
    /// Chunks without a checksum.
    pub unchecked: u64,
}

/// A schema of the file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SchemaReport {
    /// Its id in the file.
    pub id: u16,
    /// Its name.
    pub name: String,
    /// Its encoding: `protobuf`, `ros2msg`, …
    pub encoding: String,
    /// Length of its definition, bytes.
    pub bytes: u64,
    /// Checksum of its definition. Repeated definitions must be equal.
    #[serde(skip)]
    pub(super) crc: u32,
}

/// An attachment of the file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AttachmentReport {
    /// Its name.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// Length of its data, bytes.
    pub bytes: u64,
    /// When it was recorded, ns.
    pub log_ns: u64,
    /// When it was created, ns.
    pub create_ns: u64,
}

/// A metadata record of the file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MetadataReport {
    /// Its name.
    pub name: String,
    /// Its entries.
    pub entries: BTreeMap<String, String>,
}
