//! Plausibility of record heads, for resynchronisation.

use std::io::{Read, Seek};

use mcap::records::op;

use super::chunk_header;
use super::error::ScanError;
use super::input::Input;
use super::record::{HEAD_BYTES, Head, MAGIC_BYTES};

/// The head at `offset`, if its kind exists in the format and the record fits into the file.
pub(super) fn fits(offset: u64, bytes: &[u8], file_bytes: u64) -> Option<Head> {
    let (&opcode, length) = bytes.split_first()?;
    let head = Head { offset, opcode, bytes: u64::from_le_bytes(*length.first_chunk::<8>()?) };
    let least = least_bytes(opcode)?;
    let fits = head.bytes >= least && head.end()? <= file_bytes;
    fits.then_some(head)
}

/// Minimum body length of a kind of record, bytes.
const fn least_bytes(opcode: u8) -> Option<u64> {
    Some(match opcode {
        op::HEADER | op::SUMMARY_OFFSET | op::METADATA => 8,
        op::FOOTER => 20,
        op::SCHEMA => 14,
        op::CHANNEL => 16,
        op::MESSAGE => 22,
        op::CHUNK => 40,
        op::MESSAGE_INDEX => 6,
        op::CHUNK_INDEX => 64,
        op::ATTACHMENT => 36,
        op::ATTACHMENT_INDEX => 48,
        op::STATISTICS => 46,
        op::METADATA_INDEX => 20,
        op::DATA_END => 4,
        _ => return None,
    })
}

/// True if there is a record at `offset`: by its head, its lengths, and the head of the next one.
pub(super) fn is_record<R: Read + Seek>(
    input: &mut Input<R>,
    offset: u64,
    look_ahead: bool,
) -> Result<bool, ScanError> {
    input.go_to(offset)?;
    let file_bytes = input.file_bytes();
    let bytes = input.peek(HEAD_BYTES + 104)?;
    let Some(head) =
        bytes.get(..HEAD_BYTES as usize).and_then(|bytes| fits(offset, bytes, file_bytes))
    else {
        return Ok(false);
    };
    let is_sound = match head.opcode {
        op::CHUNK => chunk_header::parse(bytes).is_ok_and(|header| {
            let known = matches!(header.compression.as_str(), "" | "zstd" | "lz4");
            let size = header.compressed_size.checked_add(40 + header.compression.len() as u64);
            known && size.is_some_and(|size| size <= head.bytes)
        }),
        op::FOOTER => head.bytes == 20,
        op::SUMMARY_OFFSET => head.bytes == 17,
        _ => true,
    };
    let Some(end) = head.end().filter(|_| is_sound) else {
        return Ok(false);
    };
    if head.opcode == op::FOOTER {
        return Ok(end + MAGIC_BYTES <= file_bytes);
    }
    if !look_ahead || end == file_bytes {
        return Ok(true);
    }
    is_record(input, end, false)
}
