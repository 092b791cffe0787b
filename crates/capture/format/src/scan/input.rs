//! Buffered input with offset and checksum.

use std::io::{self, BufRead, Read, Seek, SeekFrom};

use super::error::ScanError;
use super::record::RecordLocation;

const BUFFER_BYTES: usize = 256 << 10;
/// Maximum initial allocation for a record of unverified length, bytes.
const MAX_TRUSTED_BYTES: u64 = 1 << 20;

/// A file that is read once, in order. [`Input::go_to`] breaks the order.
pub(super) struct Input<R> {
    input: R,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    offset: u64,
    file_bytes: u64,
    /// `None` after a jump, which omits bytes.
    crc: Option<crc32fast::Hasher>,
}

impl<R: Read + Seek> Input<R> {
    pub(super) fn new(mut input: R) -> Result<Self, ScanError> {
        let io = |source| ScanError::Io { place: RecordLocation::top(0), source };
        let file_bytes = input.seek(SeekFrom::End(0)).map_err(io)?;
        input.seek(SeekFrom::Start(0)).map_err(io)?;
        Ok(Self {
            input,
            buffer: vec![0; BUFFER_BYTES],
            start: 0,
            end: 0,
            offset: 0,
            file_bytes,
            crc: Some(crc32fast::Hasher::new()),
        })
    }

    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    pub(super) fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// Checksum of everything consumed since the beginning or [`Input::restart_crc`], unless bytes
    /// were omitted.
    pub(super) fn crc(&self) -> Option<u32> {
        Some(self.crc.clone()?.finalize())
    }

    pub(super) fn restart_crc(&mut self) {
        self.crc = Some(crc32fast::Hasher::new());
    }

    fn io(&self, source: io::Error) -> ScanError {
        ScanError::Io { place: RecordLocation::top(self.offset), source }
    }

    /// Reads `bytes`, or as many as there are, replacing the contents of `into`.
    pub(super) fn read_up_to(&mut self, bytes: u64, into: &mut Vec<u8>) -> Result<(), ScanError> {
        fill(self, bytes, into).map_err(|error| self.io(error))
    }

    /// Skips `bytes`, or as many as there are.
    pub(super) fn skip(&mut self, bytes: u64) -> Result<(), ScanError> {
        let mut left = bytes;
        while left > 0 {
            let found = match self.fill_buf() {
                Ok(found) => found.len(),
                Err(error) => return Err(self.io(error)),
            };
            if found == 0 {
                break;
            }
            let taken = found.min(usize::try_from(left).unwrap_or(usize::MAX));
            self.consume(taken);
            left -= taken as u64;
        }
        Ok(())
    }

    /// The next `bytes`, or as many as there are, without consuming them. At most [`BUFFER_BYTES`].
    pub(super) fn peek(&mut self, bytes: u64) -> Result<&[u8], ScanError> {
        let wanted = usize::try_from(bytes).unwrap_or(usize::MAX).min(BUFFER_BYTES);
        if self.end - self.start < wanted {
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
            while self.end < wanted {
                match self.input.read(&mut self.buffer[self.end..]) {
                    Ok(0) => break,
                    Ok(read) => self.end += read,
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    Err(error) => return Err(self.io(error)),
                }
            }
        }
        let found = wanted.min(self.end - self.start);
        Ok(&self.buffer[self.start..self.start + found])
    }

    /// The offset, and the checksum so far.
    pub(super) fn mark(&self) -> Mark {
        Mark { offset: self.offset, crc: self.crc.clone() }
    }

    /// Returns to a mark, as if nothing had been read since.
    pub(super) fn back_to(&mut self, mark: Mark) -> Result<(), ScanError> {
        self.go_to(mark.offset)?;
        self.crc = mark.crc;
        Ok(())
    }

    /// Continues at `offset`. There is no checksum until it is restarted.
    pub(super) fn go_to(&mut self, offset: u64) -> Result<(), ScanError> {
        if let Err(error) = self.input.seek(SeekFrom::Start(offset)) {
            return Err(self.io(error));
        }
        (self.start, self.end) = (0, 0);
        self.offset = offset;
        self.crc = None;
        Ok(())
    }
}

/// A position to return to.
pub(super) struct Mark {
    offset: u64,
    crc: Option<crc32fast::Hasher>,
}

/// Reads up to `bytes`, replacing the contents of `into`. A wrong length allocates little.
pub(super) fn fill(input: &mut impl Read, bytes: u64, into: &mut Vec<u8>) -> io::Result<()> {
    into.clear();
    into.shrink_to(4 * MAX_TRUSTED_BYTES as usize);
    into.reserve(usize::try_from(bytes.min(MAX_TRUSTED_BYTES)).unwrap_or_default());
    input.take(bytes).read_to_end(into)?;
    Ok(())
}

impl<R: Read> Read for Input<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let found = self.fill_buf()?;
        let taken = found.len().min(into.len());
        into[..taken].copy_from_slice(&found[..taken]);
        self.consume(taken);
        Ok(taken)
    }
}

impl<R: Read> BufRead for Input<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.start == self.end {
            self.start = 0;
            self.end = self.input.read(&mut self.buffer)?;
        }
        Ok(&self.buffer[self.start..self.end])
    }

    fn consume(&mut self, bytes: usize) {
        if let Some(crc) = &mut self.crc {
            crc.update(&self.buffer[self.start..self.start + bytes]);
        }
        self.start += bytes;
        self.offset += bytes as u64;
    }
}
