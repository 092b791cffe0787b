//! The head of a chunk.

use mcap::records::ChunkHeader;

use super::record::HEAD_BYTES;

/// Fields of a chunk's head without the name of its compression, bytes.
pub(super) const FIXED_BYTES: u64 = 40;
/// Maximum length of a compression's name, bytes.
pub(super) const MAX_NAME_BYTES: u64 = 64;
/// Parses a chunk's head. The error has no reason if the bytes are too few.
pub(super) fn parse(bytes: &[u8]) -> Result<ChunkHeader, Option<String>> {
    fn number<const N: usize>(bytes: &mut &[u8]) -> Result<[u8; N], Option<String>> {
        let (number, rest) = bytes.split_first_chunk::<N>().ok_or(None)?;
        *bytes = rest;
        Ok(*number)
    }
    let mut rest = bytes.get(HEAD_BYTES as usize..).ok_or(None)?;
    let message_start_time = u64::from_le_bytes(number(&mut rest)?);
    let message_end_time = u64::from_le_bytes(number(&mut rest)?);
    let uncompressed_size = u64::from_le_bytes(number(&mut rest)?);
    let uncompressed_crc = u32::from_le_bytes(number(&mut rest)?);
    let name_bytes = u32::from_le_bytes(number(&mut rest)?);
    if u64::from(name_bytes) > MAX_NAME_BYTES {
        let detail = format!(
            "the name of its compression has {name_bytes} bytes, allowed are {MAX_NAME_BYTES}"
        );
        return Err(Some(detail));
    }
    let (name, mut rest) = rest.split_at_checked(name_bytes as usize).ok_or(None)?;
    let compression = String::from_utf8(name.to_vec())
        .map_err(|_| Some("the name of its compression is not UTF-8".to_owned()))?;
    let compressed_size = u64::from_le_bytes(number(&mut rest)?);
    Ok(ChunkHeader {
        message_start_time,
        message_end_time,
        uncompressed_size,
        uncompressed_crc,
        compression,
        compressed_size,
    })
}
