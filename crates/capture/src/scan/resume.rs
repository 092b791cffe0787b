//! Where to continue after something that cannot be read.

use std::io::{Read, Seek};

use super::error::ScanError;
use super::plausible::{fits, is_record};
use super::record::HEAD_BYTES;
use super::source::Source;

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

impl Failure {
    /// Where the next record stands, as far as bytes can tell; `None` when nothing more looks like one.
    pub(super) fn next_record<R: Read + Seek>(
        self,
        source: &mut Source<R>,
    ) -> Result<Option<u64>, ScanError> {
        match self.next {
            Some(next) if is_record(source, next, true)? => Ok(Some(next)),
            _ => search(source, self.search_from),
        }
    }
}

/// Bytes that were passed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Skipped {
    /// The first of them.
    pub from: u64,
    /// The first byte after them.
    pub to: u64,
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
