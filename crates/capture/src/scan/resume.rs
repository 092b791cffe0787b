//! Where to go on after something that cannot be read.

use std::io::{Read, Seek};

use mcap::records::op;

use super::source::Source;
use super::{HEAD_BYTES, Head, MAGIC_BYTES, Scan, ScanError, State, chunk};

/// Bytes looked through at a time.
const WINDOW_BYTES: u64 = 64 << 10;

/// What is known of the place that could not be read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Failure {
    /// The first byte that was not read.
    pub(super) from: u64,
    /// Nothing before this byte is of use.
    pub(super) search_from: u64,
    /// Where the next record should stand, if the length of the bad one is believed.
    pub(super) next: Option<u64>,
}

/// Bytes that were passed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Skipped {
    /// The first of them.
    pub from: u64,
    /// The first byte after them.
    pub to: u64,
}

impl<R: Read + Seek> Scan<R> {
    /// After an error: goes on at the next place that looks like a record, and says what is passed
    /// over. Within an uncompressed chunk its further records are found, and yielded as if they
    /// stood at top level. `None` when nothing more looks like a record.
    ///
    /// # Errors
    /// [`ScanError::Io`].
    pub fn resume(&mut self) -> Result<Option<Skipped>, ScanError> {
        let Some(failure) = self.failed.take() else {
            return Ok(None);
        };
        let State::Top(mut source) = std::mem::replace(&mut self.state, State::Gone) else {
            return Ok(None);
        };
        let from = failure.from;
        let believed = match failure.next {
            Some(next) if is_record(&mut source, next, true)? => Some(next),
            _ => None,
        };
        let to = match believed {
            Some(next) => Some(next),
            None => search(&mut source, failure.search_from)?,
        };
        let Some(to) = to else {
            return Ok(None);
        };
        source.go_to(to)?;
        self.state = State::Top(source);
        Ok(Some(Skipped { from, to }))
    }
}

/// The first place from `from` on that looks like a record.
fn search<R: Read + Seek>(source: &mut Source<R>, from: u64) -> Result<Option<u64>, ScanError> {
    let mut window = Vec::new();
    let mut start = from;
    while start < source.file_bytes() {
        source.go_to(start)?;
        source.read_up_to(WINDOW_BYTES + HEAD_BYTES, &mut window)?;
        for at in 0..window.len().min(WINDOW_BYTES as usize) {
            let offset = start + at as u64;
            let Some(bytes) = window.get(at..at + HEAD_BYTES as usize) else {
                break;
            };
            if fits(offset, bytes, source.file_bytes()).is_some()
                && is_record(source, offset, true)?
            {
                return Ok(Some(offset));
            }
        }
        start += WINDOW_BYTES;
    }
    Ok(None)
}

/// The head at `offset`, if it is of a kind that the format has and the record fits the file.
fn fits(offset: u64, bytes: &[u8], file_bytes: u64) -> Option<Head> {
    let (&opcode, length) = bytes.split_first()?;
    let head = Head {
        offset,
        opcode,
        bytes: u64::from_le_bytes(*length.first_chunk::<8>()?),
    };
    let least = least_bytes(opcode)?;
    let fits = head.bytes >= least && head.end()? <= file_bytes;
    fits.then_some(head)
}

/// Shortest body of a kind of record, bytes.
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

/// Whether a record stands at `offset`: its head, its lengths, and the head of what follows it.
pub(super) fn is_record<R: Read + Seek>(
    source: &mut Source<R>,
    offset: u64,
    look_ahead: bool,
) -> Result<bool, ScanError> {
    source.go_to(offset)?;
    let file_bytes = source.file_bytes();
    let bytes = source.peek(HEAD_BYTES + 104)?;
    let Some(head) = bytes
        .get(..HEAD_BYTES as usize)
        .and_then(|bytes| fits(offset, bytes, file_bytes))
    else {
        return Ok(false);
    };
    let is_sound = match head.opcode {
        op::CHUNK => chunk::header(bytes).is_ok_and(|header| {
            let known = matches!(header.compression.as_str(), "" | "zstd" | "lz4");
            let size = header
                .compressed_size
                .checked_add(40 + header.compression.len() as u64);
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
    is_record(source, end, false)
}
