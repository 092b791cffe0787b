//! A chunk's records, decompressed and checked completely before the first of them is used.
//!
//! The library would allocate as many bytes as a chunk's head claims. Here only actually
//! decompressed bytes are allocated.

use std::io::{self, Read};

use mcap::McapError;
use mcap::records::{Record, op};

use crate::scan::{MAX_RECORD_BYTES, is_opcode, parse_record, zstd_decoder};

/// Opcode and length before every record, bytes.
const HEAD_BYTES: usize = 9;

#[derive(Default)]
pub(crate) struct Records {
    bytes: Vec<u8>,
    at: usize,
}

impl Records {
    /// Total length of the records, bytes.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Opcode and body of the next record.
    pub(crate) fn next(&mut self) -> Option<Result<(u8, &[u8]), McapError>> {
        let rest = self.bytes.get(self.at..).filter(|rest| !rest.is_empty())?;
        let record = rest.split_first_chunk::<HEAD_BYTES>().and_then(|(head, rest)| {
            let [opcode, length @ ..] = head;
            let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
            let body = rest.get(..length)?;
            is_opcode(*opcode).then_some((*opcode, body))
        });
        self.at += record.map_or(rest.len(), |(_, body)| HEAD_BYTES + body.len());
        Some(record.ok_or(McapError::UnexpectedEoc))
    }
}

/// The records of a chunk's body, at most `max_bytes` decompressed.
pub(crate) fn records(body: &[u8], max_bytes: u64) -> Result<Records, McapError> {
    let chunk = parse_record(op::CHUNK, body);
    let Record::Chunk { header, data } =
        chunk.map_err(|error| error.unwrap_or(McapError::UnexpectedEoc))?
    else {
        return Err(McapError::UnexpectedEoc);
    };
    let size = header.uncompressed_size;
    if size > MAX_RECORD_BYTES.min(max_bytes) {
        return Err(McapError::ChunkTooLarge(size));
    }
    let bytes = match header.compression.as_str() {
        "" => Ok(data.into_owned()),
        "zstd" => zstd_decoder(&*data).and_then(|decoder| up_to(size, decoder)),
        "lz4" => lz4::Decoder::new(&*data).and_then(|decoder| up_to(size, decoder)),
        other => return Err(McapError::UnsupportedCompression(other.to_owned())),
    };
    let bytes = bytes.map_err(|error| McapError::DecompressionError(error.to_string()))?;
    if bytes.len() as u64 != size {
        return Err(McapError::DecompressionError(format!(
            "found {} bytes of records, the chunk's head says {size}",
            bytes.len()
        )));
    }
    let (saved, calculated) = (header.uncompressed_crc, crc32fast::hash(&bytes));
    if saved != 0 && saved != calculated {
        return Err(McapError::BadChunkCrc { saved, calculated });
    }
    Ok(Records { bytes, at: 0 })
}

/// The decompressed bytes, if there are at most `size`. Otherwise one more.
fn up_to(size: u64, decoder: impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    decoder.take(size + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}
