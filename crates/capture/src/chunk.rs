//! A chunk's records, decompressed and checked as a whole before the first of them is looked at.
//!
//! The library would make room for as many bytes as a chunk's head claims; here room is made for
//! those that come out of the decompressor.

use std::io::{self, Read};

use mcap::McapError;
use mcap::records::{Record, op};

use crate::scan::{parse_record, zstd_decoder};

/// A record or a chunk longer than this is taken for damage, bytes.
pub(crate) const MOST_BYTES: usize = 256 << 20;

/// Opcode and length before every record, bytes.
const HEAD_BYTES: usize = 9;

/// Records one after another.
#[derive(Default)]
pub(crate) struct Records {
    bytes: Vec<u8>,
    at: usize,
}

impl Records {
    /// Opcode and body of the next record.
    pub(crate) fn next(&mut self) -> Option<Result<(u8, &[u8]), McapError>> {
        let rest = self.bytes.get(self.at..).filter(|rest| !rest.is_empty())?;
        let record = rest
            .split_first_chunk::<HEAD_BYTES>()
            .and_then(|(head, rest)| {
                let [opcode, length @ ..] = head;
                let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
                Some((*opcode, rest.get(..length)?))
            });
        self.at += record.map_or(rest.len(), |(_, body)| HEAD_BYTES + body.len());
        Some(record.ok_or(McapError::UnexpectedEoc))
    }
}

/// The records of the chunk with this body.
pub(crate) fn records(body: &[u8]) -> Result<Records, McapError> {
    let chunk = parse_record(op::CHUNK, body);
    let Record::Chunk { header, data } =
        chunk.map_err(|error| error.unwrap_or(McapError::UnexpectedEoc))?
    else {
        return Err(McapError::UnexpectedEoc);
    };
    let size = header.uncompressed_size;
    if size > MOST_BYTES as u64 {
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

/// All that comes out of a decompressor, if it is not more than `size` bytes; else one more.
fn up_to(size: u64, decoder: impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    decoder.take(size + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}
