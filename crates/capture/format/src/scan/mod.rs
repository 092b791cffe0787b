//! Scans any MCAP file from its first byte to its last, in any state.
//!
//! [`Scan`] yields every record with its location. The file is untrusted: no length causes an
//! allocation of more than [`MAX_RECORD_BYTES`], chunks are decompressed as a stream, and each
//! error names the byte. After an error, [`Scan::resume`] continues at the next plausible record.

mod chunk;
mod chunk_header;
mod error;
mod input;
mod layout;
mod plausible;
mod record;
mod resume;

use std::fmt;
use std::io::{Read, Seek};

use joulebus_files::foreign;
use mcap::records::{self, op};

use chunk::Chunk;
pub(crate) use chunk::zstd_decoder;
pub use error::ScanError;
use input::Input;
pub use record::{ChunkFrame, Crc, MAX_RECORD_BYTES, RecordLocation, kind_name};
use record::{HEAD_BYTES, Head, MAGIC_BYTES};
pub(crate) use record::{is_opcode, max_expanded};
pub use resume::Skipped;

/// An event of a scan.
#[derive(Debug)]
pub enum Event<'a> {
    /// A record, at top level or in a chunk.
    Record(Raw<'a>),
    /// The records of a chunk follow.
    ChunkBegins(ChunkFrame),
    /// All records of the chunk have been read.
    ChunkEnds {
        /// The chunk.
        frame: ChunkFrame,
        /// Checksum of its records, decompressed.
        crc: Crc,
    },
    /// A record longer than [`MAX_RECORD_BYTES`], which was skipped.
    TooLong {
        /// Its location.
        place: RecordLocation,
        /// Its opcode.
        opcode: u8,
        /// Its length without its head.
        bytes: u64,
    },
}

/// An unparsed record.
#[derive(Debug)]
pub struct Raw<'a> {
    /// Its location.
    pub place: RecordLocation,
    /// Its opcode, see [`mcap::records::op`].
    pub opcode: u8,
    /// The bytes after opcode and length.
    pub body: &'a [u8],
    /// Checksum of the data section in its DataEnd, of the summary in the footer, if all of it was
    /// read. `None` elsewhere.
    pub crc: Option<Crc>,
}

impl<'a> Raw<'a> {
    /// Parses the record.
    ///
    /// # Errors
    /// [`ScanError::Record`]: its fields exceed its length, text is not UTF-8, or the checksum of
    /// an attachment is wrong.
    pub fn parse(&self) -> Result<records::Record<'a>, ScanError> {
        let refuse = |detail: String| ScanError::Record {
            place: self.place,
            what: kind_name(self.opcode),
            detail,
        };
        parse_record(self.opcode, self.body).map_err(|error| match error {
            Some(error) => refuse(in_words(&error)),
            None => refuse("its fields do not fit its length".to_owned()),
        })
    }
}

/// Parses the record in `body`. The error has no reason if its fields exceed it. Checked first,
/// because the library allocates by stated lengths, and subtracts without checks.
pub(crate) fn parse_record(
    opcode: u8,
    body: &[u8],
) -> Result<records::Record<'_>, Option<mcap::McapError>> {
    if !layout::fits(opcode, body) {
        return Err(None);
    }
    mcap::parse_record(opcode, body).map_err(Some)
}

/// The error with its cause, on one line.
fn in_words(error: &dyn std::error::Error) -> String {
    let mut words = error.to_string();
    if let Some(source) = error.source() {
        words = format!("{words}: {source}");
    }
    words.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A scan over a file.
pub struct Scan<R> {
    state: State<R>,
    buffer: Vec<u8>,
    /// Location of the last error, and what is known of its surroundings.
    failed: Option<resume::Failure>,
    file_bytes: u64,
    passes_chunks: bool,
}

impl<R> fmt::Debug for Scan<R> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Scan")
            .field("failed", &self.failed)
            .field("file_bytes", &self.file_bytes)
            .finish_non_exhaustive()
    }
}

/// State of the scan.
///
/// 1. It begins at the `Top`, where records follow each other.
/// 2. A chunk moves the input into the decompressor. Its records are yielded until it ends or
///    breaks. Then the input moves back to the `Top`.
/// 3. An error notes where it was, in [`Scan::failed`], and ends the scan.
/// 4. [`Scan::resume`] continues at the next plausible record, at the `Top`.
/// 5. It is `Gone` for good when a decompressor has kept the input, and after the footer.
enum State<R> {
    Top(Input<R>),
    Chunk(Box<Chunk<R>>),
    /// While the input is moved, or after a decompressor has kept it.
    Gone,
}

impl<R: Read + Seek> Scan<R> {
    /// Starts a scan.
    ///
    /// # Errors
    /// [`ScanError::NotMcap`] if it does not begin like an MCAP file, [`ScanError::Io`].
    pub fn new(input: R) -> Result<Self, ScanError> {
        match Self::anyway(input)? {
            (scan, None) => Ok(scan),
            (_, Some(not_mcap)) => Err(not_mcap),
        }
    }

    /// Starts a scan, also of a file whose first bytes are not those of an MCAP file: the error
    /// beside it reports that, and [`Scan::resume`] finds the records that there are.
    pub(crate) fn anyway(input: R) -> Result<(Self, Option<ScanError>), ScanError> {
        let mut input = Input::new(input)?;
        let file_bytes = input.file_bytes();
        let mut magic = Vec::new();
        input.read_up_to(MAGIC_BYTES, &mut magic)?;
        let (mut failed, mut not_mcap) = (None, None);
        if magic != mcap::MAGIC {
            let mut rest = Vec::new();
            input.read_up_to(foreign::HEAD_BYTES, &mut rest)?;
            let found = match foreign::recognise(&[magic.as_slice(), &rest].concat()) {
                Some(foreign) => foreign.to_string(),
                None if magic.is_empty() => "an empty file".to_owned(),
                None => format!("{magic:02x?}"),
            };
            not_mcap = Some(ScanError::NotMcap { found });
            failed = Some(resume::Failure { from: 0, search_from: 0, next: Some(MAGIC_BYTES) });
        }
        let state = State::Top(input);
        let passes_chunks = false;
        let scan = Self { state, buffer: Vec::new(), failed, file_bytes, passes_chunks };
        Ok((scan, not_mcap))
    }

    /// Length of the file, bytes.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// The same scan without the records of chunks, and without the ends of these.
    pub(crate) fn outside_of_chunks(self) -> Self {
        Self { passes_chunks: true, ..self }
    }

    /// Continues at `offset`, the start of a record. The checksum of the current section is then
    /// unknown.
    pub(crate) fn go_to(&mut self, offset: u64) -> Result<(), ScanError> {
        if let State::Top(input) = &mut self.state {
            input.go_to(offset)?;
            input.restart_crc();
        }
        self.failed = None;
        Ok(())
    }

    /// After an error: continues at the next plausible record, and returns the skipped range.
    /// Within an uncompressed chunk its further records are found, and yielded as if at top level.
    /// `None` if there is no further plausible record.
    ///
    /// # Errors
    /// [`ScanError::Io`].
    pub fn resume(&mut self) -> Result<Option<Skipped>, ScanError> {
        let Some(failure) = self.failed.take() else {
            return Ok(None);
        };
        let State::Top(mut input) = std::mem::replace(&mut self.state, State::Gone) else {
            return Ok(None);
        };
        let Some(to) = failure.next_record(&mut input)? else {
            return Ok(None);
        };
        input.go_to(to)?;
        self.state = State::Top(input);
        let from = failure.from;
        Ok(Some(Skipped { from, to }))
    }

    /// The next event. `None` after the last byte of a complete file.
    ///
    /// # Errors
    /// [`ScanError`]. The scan has then ended, unless [`Scan::resume`] is called.
    pub fn next_event(&mut self) -> Result<Option<Event<'_>>, ScanError> {
        if self.failed.is_some() {
            return Ok(None);
        }
        match std::mem::replace(&mut self.state, State::Gone) {
            State::Top(input) => self.event_at_top(input),
            State::Chunk(chunk) => self.event_in_chunk(chunk),
            State::Gone => Ok(None),
        }
    }

    fn event_at_top(&mut self, mut input: Input<R>) -> Result<Option<Event<'_>>, ScanError> {
        let head = match head(&mut input) {
            Ok(head) => head,
            Err(error) => return Err(self.fail(input, error)),
        };
        match head.opcode {
            op::CHUNK if self.passes_chunks => match chunk::pass(&mut input, head) {
                Ok(frame) => {
                    self.state = State::Top(input);
                    Ok(Some(Event::ChunkBegins(frame)))
                }
                Err(error) => Err(self.fail(input, error)),
            },
            op::CHUNK => match Chunk::begin(input, head) {
                Ok(chunk) => {
                    let frame = chunk.frame().clone();
                    self.state = State::Chunk(chunk);
                    Ok(Some(Event::ChunkBegins(frame)))
                }
                Err((Some(input), error)) => Err(self.fail(input, error)),
                Err((None, error)) => Err(error),
            },
            op::FOOTER => self.footer(input, head),
            _ => self.record(input, head),
        }
    }

    fn record(&mut self, mut input: Input<R>, head: Head) -> Result<Option<Event<'_>>, ScanError> {
        let place = RecordLocation::top(head.offset);
        let crc = input.crc();
        let read = if head.bytes > MAX_RECORD_BYTES {
            input.skip(HEAD_BYTES + head.bytes)
        } else {
            input.skip(HEAD_BYTES).and_then(|()| input.read_up_to(head.bytes, &mut self.buffer))
        };
        let read = read.and_then(|()| self.check_length(&mut input, head));
        if let Err(error) = read {
            return Err(self.fail(input, error));
        }
        if head.bytes > MAX_RECORD_BYTES {
            self.state = State::Top(input);
            let (opcode, bytes) = (head.opcode, head.bytes);
            return Ok(Some(Event::TooLong { place, opcode, bytes }));
        }
        let mut found = None;
        if head.opcode == op::DATA_END {
            input.restart_crc();
            found = checked(&self.buffer, 0, crc);
        }
        self.state = State::Top(input);
        Ok(Some(Event::Record(Raw { place, opcode: head.opcode, body: &self.buffer, crc: found })))
    }

    /// A record that is longer than its fields may be one of a later version. Its length is wrong
    /// if no record follows it.
    fn check_length(&self, input: &mut Input<R>, head: Head) -> Result<(), ScanError> {
        let is_too_long = head.bytes > MAX_RECORD_BYTES;
        let spare = if is_too_long { None } else { layout::spare(head.opcode, &self.buffer) };
        if !is_too_long && spare.is_none_or(|bytes| bytes == 0) {
            return Ok(());
        }
        let (offset, file_bytes) = (input.offset(), input.file_bytes());
        let next = input.peek(HEAD_BYTES)?;
        if next.is_empty() || plausible::fits(offset, next, file_bytes).is_some() {
            return Ok(());
        }
        let detail = format!("its length of {} bytes is wrong: no record follows", head.bytes);
        let place = RecordLocation::top(head.offset);
        Err(ScanError::Record { place, what: kind_name(head.opcode), detail })
    }

    /// The footer's checksum covers the summary and the footer up to the checksum.
    fn footer(&mut self, mut input: Input<R>, head: Head) -> Result<Option<Event<'_>>, ScanError> {
        const FOOTER_BYTES: u64 = 20;
        let place = RecordLocation::top(head.offset);
        if head.bytes != FOOTER_BYTES {
            let detail = format!("it is {} bytes long, not {FOOTER_BYTES}", head.bytes);
            let what = kind_name(op::FOOTER);
            return Err(self.fail(input, ScanError::Record { place, what, detail }));
        }
        let mut covered = Vec::new();
        let read = input
            .skip(HEAD_BYTES)
            .and_then(|()| input.read_up_to(FOOTER_BYTES - 4, &mut covered))
            .map(|()| input.crc())
            .and_then(|crc| Ok((crc, input.read_up_to(4, &mut self.buffer)?)))
            .and_then(|(crc, ())| Ok((crc, end_magic(&mut input)?)));
        let (found, ()) = match read {
            Ok(read) => read,
            Err(error) => return Err(self.fail(input, error)),
        };
        covered.extend_from_slice(&self.buffer);
        self.buffer = covered;
        // Nothing follows the magic: `Gone` ends the scan.
        self.state = State::Gone;
        Ok(Some(Event::Record(Raw {
            place,
            opcode: head.opcode,
            body: &self.buffer,
            crc: checked(&self.buffer, 16, found),
        })))
    }

    fn event_in_chunk(&mut self, mut chunk: Box<Chunk<R>>) -> Result<Option<Event<'_>>, ScanError> {
        match chunk.next(&mut self.buffer) {
            Ok(chunk::Step::Record { place, opcode }) => {
                self.state = State::Chunk(chunk);
                Ok(Some(Event::Record(Raw { place, opcode, body: &self.buffer, crc: None })))
            }
            Ok(chunk::Step::TooLong { place, opcode, bytes }) => {
                self.state = State::Chunk(chunk);
                Ok(Some(Event::TooLong { place, opcode, bytes }))
            }
            Ok(chunk::Step::End { crc }) => {
                let frame = chunk.frame().clone();
                match chunk.end() {
                    Ok(input) => {
                        self.state = State::Top(input);
                        Ok(Some(Event::ChunkEnds { frame, crc }))
                    }
                    Err((input, error)) => {
                        let after = input.offset();
                        let error = self.fail(input, error);
                        self.failed =
                            Some(resume::Failure { from: after, search_from: after, next: None });
                        Err(error)
                    }
                }
            }
            Err(error) => {
                let failure = chunk.failure();
                self.state = State::Top(chunk.into_input());
                self.failed = Some(failure);
                Err(error)
            }
        }
    }

    fn fail(&mut self, input: Input<R>, error: ScanError) -> ScanError {
        self.state = State::Top(input);
        self.failed = Some(resume::Failure {
            from: error.place().offset,
            search_from: error.place().offset + 1,
            next: None,
        });
        error
    }
}

/// Calls `take` with every readable record, from the beginning of the file. Returns the damage.
///
/// # Errors
/// Errors of `take`, or [`ScanError`] if the file is not an MCAP file or cannot be read.
pub(crate) fn each_record<E: From<ScanError>>(
    input: impl Read + Seek,
    mut take: impl FnMut(records::Record<'_>) -> Result<(), E>,
) -> Result<Vec<String>, E> {
    let mut scan = Scan::new(input)?;
    let mut damage = Vec::new();
    loop {
        match scan.next_event() {
            Ok(Some(Event::Record(raw))) => match raw.parse() {
                Ok(record) => take(record)?,
                Err(error) => damage.push(error.to_string()),
            },
            Ok(Some(Event::ChunkEnds { frame, crc })) if crc.is_wrong() => {
                damage.push(format!("byte {}: chunk: its checksum is wrong", frame.offset));
            }
            Ok(Some(_)) => {}
            Ok(None) => return Ok(damage),
            Err(error @ ScanError::Io { .. }) => return Err(error.into()),
            Err(error) => {
                damage.push(error.to_string());
                if scan.resume()?.is_none() {
                    return Ok(damage);
                }
            }
        }
    }
}

/// Reads the head of the next record without consuming it.
fn head<R: Read + Seek>(input: &mut Input<R>) -> Result<Head, ScanError> {
    let offset = input.offset();
    let place = RecordLocation::top(offset);
    let rest = input.file_bytes().saturating_sub(offset);
    let bytes = input.peek(HEAD_BYTES)?;
    let Some((&opcode, length)) = bytes.split_first() else {
        let what = "file, without its footer";
        return Err(ScanError::EndsEarly { place, what, missing: None });
    };
    let Ok(length) = <[u8; 8]>::try_from(length) else {
        let what = "head of a record";
        let missing = Some(HEAD_BYTES - rest);
        return Err(ScanError::EndsEarly { place, what, missing });
    };
    if !is_opcode(opcode) {
        return Err(ScanError::Opcode { place, found: opcode });
    }
    let head = Head { offset, opcode, bytes: u64::from_le_bytes(length) };
    match head.end() {
        Some(end) if end <= input.file_bytes() || opcode == op::CHUNK => Ok(head),
        end => {
            let missing = end.map(|end| end - input.file_bytes());
            let what = kind_name(opcode);
            Err(ScanError::EndsEarly { place, what, missing })
        }
    }
}

fn end_magic<R: Read + Seek>(input: &mut Input<R>) -> Result<(), ScanError> {
    let place = RecordLocation::top(input.offset());
    let mut magic = Vec::new();
    input.read_up_to(MAGIC_BYTES, &mut magic)?;
    if magic.len() < mcap::MAGIC.len() && mcap::MAGIC.starts_with(&magic) {
        let what = "bytes that end an MCAP file";
        let missing = Some(MAGIC_BYTES - magic.len() as u64);
        return Err(ScanError::EndsEarly { place, what, missing });
    }
    if magic != mcap::MAGIC {
        return Err(ScanError::EndMagic { place, found: magic });
    }
    match input.file_bytes() - input.offset() {
        0 => Ok(()),
        bytes => Err(ScanError::Trailing { place: RecordLocation::top(input.offset()), bytes }),
    }
}

/// The checksum stored in a body, with that of the bytes read.
fn checked(body: &[u8], at: usize, found: Option<u32>) -> Option<Crc> {
    let saved = u32::from_le_bytes(*body.get(at..)?.first_chunk::<4>()?);
    let found = found?;
    Some(Crc { saved, found })
}
