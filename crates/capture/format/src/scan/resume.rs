//! Resynchronisation after unreadable data.

use std::io::{Read, Seek};

use super::error::ScanError;
use super::input::Input;
use super::plausible::{fits, is_record};
use super::record::HEAD_BYTES;

/// Bytes searched at a time.
const WINDOW_BYTES: u64 = 64 << 10;

/// Knowledge about the unreadable location.
#[derive(Debug, Clone, Copy)]
pub(super) struct Failure {
    /// The first unread byte.
    pub(super) from: u64,
    pub(super) search_from: u64,
    /// Expected offset of the next record, if the length of the bad one is right.
    pub(super) next: Option<u64>,
}

impl Failure {
    /// Offset of the next plausible record. `None` if there is none.
    pub(super) fn next_record<R: Read + Seek>(
        self,
        input: &mut Input<R>,
    ) -> Result<Option<u64>, ScanError> {
        match self.next {
            Some(next) if is_record(input, next, true)? => Ok(Some(next)),
            _ => search(input, self.search_from),
        }
    }
}

/// A skipped range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Skipped {
    /// Its first byte.
    pub from: u64,
    /// The first byte after it.
    pub to: u64,
}

/// The first plausible record at or after `from`.
fn search<R: Read + Seek>(input: &mut Input<R>, from: u64) -> Result<Option<u64>, ScanError> {
    let mut window = Vec::new();
    let mut start = from;
    while start < input.file_bytes() {
        input.go_to(start)?;
        input.read_up_to(WINDOW_BYTES + HEAD_BYTES, &mut window)?;
        for at in 0..window.len().min(WINDOW_BYTES as usize) {
            let offset = start + at as u64;
            let Some(bytes) = window.get(at..at + HEAD_BYTES as usize) else {
                break;
            };
            if fits(offset, bytes, input.file_bytes()).is_some() && is_record(input, offset, true)?
            {
                return Ok(Some(offset));
            }
        }
        start += WINDOW_BYTES;
    }
    Ok(None)
}
