//! The records in a chunk, decompressed as a stream.

use std::io::{self, BufRead, Read, Seek, Take};

use super::chunk_header::{self, FIXED_BYTES, MAX_NAME_BYTES};
use super::error::ScanError;
use super::input::{Input, fill};
use super::plausible::is_record;
use super::record::{
    ChunkFrame, Crc, HEAD_BYTES, Head, MAX_RECORD_BYTES, RecordLocation, is_opcode, max_expanded,
};
use super::resume::Failure;

/// Maximum window of a zstd frame, as a power of two: 32 MiB, more than levels up to 19 use.
const MAX_WINDOW_LOG: u32 = 25;

/// Number of bytes skipped per read.
const PASSED_AT_ONCE: u64 = 1 << 20;

/// A chunk being read.
pub(super) struct Chunk<R> {
    frame: ChunkFrame,
    body: Body<R>,
    crc: crc32fast::Hasher,
    read: u64,
    /// Offset of the current record in the decompressed records.
    record: u64,
}

enum Body<R> {
    Plain(Take<Input<R>>),
    Zstd(zstd::Decoder<'static, Take<Input<R>>>),
    Lz4(lz4::Decoder<Take<Input<R>>>),
}

/// Next item in a chunk.
pub(super) enum Step {
    /// A record, its body in the buffer.
    Record {
        place: RecordLocation,
        opcode: u8,
    },
    TooLong {
        place: RecordLocation,
        opcode: u8,
        bytes: u64,
    },
    End {
        crc: Crc,
    },
}

impl<R: Read> Read for Body<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(body) => body.read(into),
            Self::Zstd(body) => body.read(into),
            Self::Lz4(body) => body.read(into),
        }
    }
}

impl<R: Read> Body<R> {
    fn into_input(self) -> Input<R> {
        match self {
            Self::Plain(body) => body,
            Self::Zstd(body) => body.finish(),
            Self::Lz4(body) => body.finish().0,
        }
        .into_inner()
    }
}

impl<R: Read + Seek> Chunk<R> {
    /// Reads the head of the chunk. The input is returned if the chunk cannot be read, unless
    /// memory for the decompressor was lacking.
    #[expect(clippy::result_large_err, reason = "the input remains usable")]
    pub(super) fn begin(
        mut input: Input<R>,
        head: Head,
    ) -> Result<Box<Self>, (Option<Input<R>>, ScanError)> {
        let frame = match frame(&mut input, head) {
            Ok(frame) => frame,
            Err(error) => return Err((Some(input), error)),
        };
        let limit = frame.header.compressed_size;
        let no_memory = |error: io::Error| (None, failed(&frame, 0, &error));
        let body = match frame.header.compression.as_str() {
            "" => Body::Plain(input.take(limit)),
            "zstd" => Body::Zstd(zstd_decoder(input.take(limit)).map_err(no_memory)?),
            "lz4" => Body::Lz4(lz4::Decoder::new(input.take(limit)).map_err(no_memory)?),
            other => {
                let error = ScanError::Compression {
                    place: RecordLocation::top(frame.offset),
                    found: other.to_owned(),
                };
                return Err((Some(input), error));
            }
        };
        Ok(Box::new(Self { frame, body, crc: crc32fast::Hasher::new(), read: 0, record: 0 }))
    }

    pub(super) fn frame(&self) -> &ChunkFrame {
        &self.frame
    }

    /// The next record. Its body is written to `buffer`.
    pub(super) fn next(&mut self, buffer: &mut Vec<u8>) -> Result<Step, ScanError> {
        let size = self.frame.header.uncompressed_size;
        if self.read == size {
            let (saved, crc) = (self.frame.header.uncompressed_crc, self.crc.clone());
            return Ok(Step::End { crc: Crc { saved, found: crc.finalize() } });
        }
        let place = self.place();
        // Limit by decompressed bytes: the header's size may be corrupt.
        let compressed = self.frame.header.compressed_size;
        let allowed = max_expanded(compressed);
        if self.read > allowed {
            let detail = format!(
                "more than {allowed} bytes of records in {compressed} compressed ones, which is the limit"
            );
            return Err(ScanError::ChunkHeader { place, detail });
        }
        self.record = self.read;
        self.take(HEAD_BYTES, buffer)?;
        let (opcode, bytes) = match buffer.split_first() {
            Some((&opcode, rest)) => match <[u8; 8]>::try_from(rest) {
                Ok(length) => (opcode, u64::from_le_bytes(length)),
                Err(_) => return Err(self.ends_early(place)),
            },
            None => return Err(self.ends_early(place)),
        };
        let left = size.saturating_sub(self.read);
        if !is_opcode(opcode) {
            return Err(ScanError::Opcode { place, found: opcode });
        }
        if bytes > left {
            return Err(ScanError::PastChunk { place, found: bytes, left });
        }
        if bytes > MAX_RECORD_BYTES {
            self.pass_over(bytes, buffer, place)?;
            return Ok(Step::TooLong { place, opcode, bytes });
        }
        self.take(bytes, buffer)?;
        if buffer.len() as u64 != bytes {
            return Err(self.ends_early(place));
        }
        Ok(Step::Record { place, opcode })
    }

    /// Takes up to `bytes` decompressed bytes.
    fn take(&mut self, bytes: u64, buffer: &mut Vec<u8>) -> Result<(), ScanError> {
        let filled = fill(&mut self.body, bytes, buffer);
        self.crc.update(buffer);
        self.read += buffer.len() as u64;
        filled.map_err(|error| {
            if self.is_cut() {
                self.ends_early(self.place())
            } else {
                failed(&self.frame, self.read, &error)
            }
        })
    }

    fn pass_over(
        &mut self,
        bytes: u64,
        buffer: &mut Vec<u8>,
        place: RecordLocation,
    ) -> Result<(), ScanError> {
        let mut left = bytes;
        while left > 0 {
            self.take(left.min(PASSED_AT_ONCE), buffer)?;
            if buffer.is_empty() {
                return Err(self.ends_early(place));
            }
            left -= buffer.len() as u64;
        }
        buffer.clear();
        Ok(())
    }

    fn place(&self) -> RecordLocation {
        RecordLocation { offset: self.frame.offset, in_chunk: Some(self.read) }
    }

    /// True if the file ends within the chunk.
    fn is_cut(&self) -> bool {
        let file_bytes = match &self.body {
            Body::Plain(body) => body.get_ref().file_bytes(),
            Body::Zstd(body) => body.get_ref().get_ref().file_bytes(),
            Body::Lz4(body) => body.reader().get_ref().file_bytes(),
        };
        self.frame.offset.saturating_add(self.frame.bytes) > file_bytes
    }

    /// The decompressed records end before the length in the head.
    fn ends_early(&self, place: RecordLocation) -> ScanError {
        if self.is_cut() {
            return ScanError::EndsEarly { place, what: "chunk", missing: None };
        }
        let size = self.frame.header.uncompressed_size;
        let detail = format!("found {} bytes of records, its head says {size}", self.read);
        ScanError::ChunkHeader { place, detail }
    }

    /// Position to continue at after an error. The records of an uncompressed chunk can be
    /// searched. Compressed data is skipped, as far as its length is plausible.
    pub(super) fn failure(&self) -> Failure {
        let end = self.frame.offset.saturating_add(self.frame.bytes);
        match &self.body {
            Body::Plain(body) => {
                let from = self.frame.offset + self.record + self.head_bytes();
                Failure {
                    from: from.min(body.get_ref().offset()),
                    search_from: from + 1,
                    next: None,
                }
            }
            Body::Zstd(body) => Self::after(body.get_ref().get_ref(), end),
            Body::Lz4(body) => Self::after(body.reader().get_ref(), end),
        }
    }

    fn after(input: &Input<R>, end: u64) -> Failure {
        let from = input.offset();
        Failure { from, search_from: from, next: (end < input.file_bytes()).then_some(end) }
    }

    /// Bytes of the chunk's record before its records.
    fn head_bytes(&self) -> u64 {
        HEAD_BYTES + FIXED_BYTES + self.frame.header.compression.len() as u64
    }

    /// Skips the rest of the chunk.
    #[expect(clippy::result_large_err, reason = "the input remains usable")]
    pub(super) fn end(self) -> Result<Input<R>, (Input<R>, ScanError)> {
        let (place, frame) = (self.place(), self.frame);
        let mut input = self.body.into_input();
        match ends(&mut input, &frame, place) {
            Ok(()) => Ok(input),
            Err(error) => Err((input, error)),
        }
    }

    pub(super) fn into_input(self) -> Input<R> {
        self.body.into_input()
    }
}

/// Reads a chunk's head, and skips its records.
pub(super) fn pass<R: Read + Seek>(
    input: &mut Input<R>,
    head: Head,
) -> Result<ChunkFrame, ScanError> {
    let frame = frame(input, head)?;
    input.skip(frame.header.compressed_size)?;
    ends(input, &frame, RecordLocation::top(frame.offset))?;
    Ok(frame)
}

/// Skips the bytes after a chunk's records. If they contain further records, the length is wrong.
fn ends<R: Read + Seek>(
    input: &mut Input<R>,
    frame: &ChunkFrame,
    place: RecordLocation,
) -> Result<(), ScanError> {
    let end = frame.offset + frame.bytes;
    let rest = end.saturating_sub(input.offset());
    if follows_wrongly(input, rest)? {
        let detail = format!("its length has {rest} bytes too many, which contain records");
        return Err(ScanError::ChunkHeader { place, detail });
    }
    if end > input.file_bytes() {
        let missing = Some(end - input.file_bytes());
        return Err(ScanError::EndsEarly { place, what: "chunk", missing });
    }
    input.skip(rest)
}

/// True if a record begins where only padding is allowed.
fn follows_wrongly<R: Read + Seek>(input: &mut Input<R>, rest: u64) -> Result<bool, ScanError> {
    if rest == 0 {
        return Ok(false);
    }
    let mark = input.mark();
    let offset = input.offset();
    let follows = is_record(input, offset, true)?;
    input.back_to(mark)?;
    Ok(follows)
}

/// A decompressor that refuses windows above the memory limit.
pub(crate) fn zstd_decoder<R: BufRead>(input: R) -> io::Result<zstd::Decoder<'static, R>> {
    let mut decoder = zstd::Decoder::with_buffer(input)?;
    decoder.window_log_max(MAX_WINDOW_LOG)?;
    Ok(decoder)
}

fn failed(frame: &ChunkFrame, read: u64, error: &io::Error) -> ScanError {
    ScanError::Decompress {
        place: RecordLocation { offset: frame.offset, in_chunk: Some(read) },
        detail: error.to_string(),
    }
}

/// Reads the head of a chunk and checks that its lengths agree.
fn frame<R: Read + Seek>(input: &mut Input<R>, head: Head) -> Result<ChunkFrame, ScanError> {
    let place = RecordLocation::top(head.offset);
    let refuse = |detail: String| ScanError::ChunkHeader { place, detail };
    let header = chunk_header::parse(input.peek(HEAD_BYTES + FIXED_BYTES + MAX_NAME_BYTES)?)
        .map_err(|detail| match detail {
            Some(detail) => refuse(detail),
            None => ScanError::EndsEarly { place, what: "chunk", missing: None },
        })?;
    let header_bytes = FIXED_BYTES + header.compression.len() as u64;
    let fits =
        header.compressed_size.checked_add(header_bytes).is_some_and(|bytes| bytes <= head.bytes);
    if !fits || head.end().is_none() {
        return Err(refuse(format!(
            "{header_bytes} bytes of head and {} of records do not fit its {} bytes",
            header.compressed_size, head.bytes
        )));
    }
    input.skip(HEAD_BYTES + header_bytes)?;
    Ok(ChunkFrame { offset: head.offset, bytes: HEAD_BYTES + head.bytes, header })
}
