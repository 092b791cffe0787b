//! The bytes of a text: their limits, their beginning, and their end.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;
use joulebus_files::foreign;

use super::error::{Fault, TrialError};
use super::limits::{FREE_TEXT_BYTES, MAX_EXPANSION, MAX_ROW_BYTES, MAX_TEXT_BYTES};

/// Bytes in which the form of a text is looked for.
const HEAD_BYTES: u64 = 64 << 10;

/// Limits the size of the text and of each row, and records whether the text ends with a newline.
pub(super) struct Meter {
    source: Box<dyn Read>,
    /// The beginning of the text, of which `taken` bytes were read.
    pub(super) head: Vec<u8>,
    taken: usize,
    failed: Option<io::Error>,
    ended: bool,
    bytes: u64,
    allowed: u64,
    /// Size of the file, if the text is compressed.
    zipped: Option<u64>,
    /// Bytes read since the end of the last complete row.
    row_bytes: u64,
    last: u8,
    /// True if the text goes on after its beginning.
    pub(super) goes_on: bool,
    /// Number of the line that was read last, and the ends of lines behind it, in bytes that were
    /// read. A carriage return ends a line without a newline.
    pub(super) line: usize,
    line_ends: VecDeque<u64>,
    after_return: bool,
}

impl Meter {
    /// The text of a file. `zipped`: the bytes are gzip, with the size of the file. `first_line`:
    /// the number of its first line.
    pub(super) fn new(source: Box<dyn Read>, zipped: Option<u64>, first_line: usize) -> Self {
        let (source, allowed): (Box<dyn Read>, u64) = match zipped {
            Some(bytes) => {
                let allowed = bytes.saturating_mul(MAX_EXPANSION).max(FREE_TEXT_BYTES);
                let source = MultiGzDecoder::new(io::BufReader::new(source));
                (Box::new(source), allowed.min(MAX_TEXT_BYTES))
            }
            None => (source, MAX_TEXT_BYTES),
        };
        Self {
            source,
            head: Vec::new(),
            taken: 0,
            failed: None,
            ended: false,
            bytes: 0,
            allowed,
            zipped,
            row_bytes: 0,
            last: b'\n',
            goes_on: false,
            line: first_line,
            line_ends: VecDeque::new(),
            after_return: false,
        }
    }

    /// Reads the beginning, and passes over what stands in front of a header.
    pub(super) fn begin(&mut self, path: &Path) -> Result<(), TrialError> {
        self.fill_head();
        if let Some(foreign) = foreign::recognise(&self.head) {
            let found = match self.zipped.is_some() {
                true => format!("{} in gzip (decompress it first)", foreign.what),
                false => foreign.to_string(),
            };
            return Err(of_another_kind(path, &found));
        }
        let is_line = self.head.contains(&b'\n');
        if let (Some(error), false) = (self.failed.take_if(|_| !is_line), is_line) {
            return Err(self.explain(path, 0, error.into()));
        }
        if self.head.len() as u64 >= MAX_ROW_BYTES && !is_line {
            return Err(row_too_long(path, 0));
        }
        self.drop_preamble();
        Ok(())
    }

    pub(super) const fn end_row(&mut self) {
        self.row_bytes = 0;
    }

    /// True if the text is over without a newline.
    pub(super) const fn is_cut(&self) -> bool {
        self.ended && !self.ends_in_line_break()
    }

    const fn is_too_long(&self) -> bool {
        self.bytes > self.allowed || self.row_bytes > MAX_ROW_BYTES
    }

    pub(super) const fn ends_in_line_break(&self) -> bool {
        matches!(self.last, b'\n' | b'\r')
    }

    /// Reads the beginning, with the header. An error comes when the rest is read.
    fn fill_head(&mut self) {
        let mut room = HEAD_BYTES;
        while room > 0 {
            let mut more = self.source.by_ref().take(room);
            let read = more.read_to_end(&mut self.head);
            // A header may be longer.
            let is_cut =
                matches!(&read, Ok(read) if *read as u64 == room) && !self.head.contains(&b'\n');
            self.goes_on = !matches!(&read, Ok(read) if (*read as u64) < room);
            room = if is_cut { MAX_ROW_BYTES.saturating_sub(self.head.len() as u64) } else { 0 };
            self.failed = read.err();
        }
        if self.head.starts_with(b"\xef\xbb\xbf") {
            self.taken = 3;
        }
    }

    /// Passes over a line of the beginning, if another one follows.
    pub(super) fn drop_line(&mut self) -> bool {
        let end = self.head.iter().position(|byte| *byte == b'\n');
        let Some(end) = end.filter(|end| end + 1 < self.head.len()) else {
            return false;
        };
        self.drop_head(end + 1);
        true
    }

    /// Passes over what some programs write in front of the header: comments, of which the last
    /// may be the header itself, and Excel's `sep=;`.
    fn drop_preamble(&mut self) {
        let mut header = None;
        loop {
            let rest = &self.head[self.taken..];
            let Some(end) = rest.iter().position(|byte| *byte == b'\n') else {
                break;
            };
            let line = &rest[..end];
            if line.starts_with(b"#") {
                let spaces = line[1..].iter().take_while(|byte| **byte == b' ').count();
                header = Some(self.taken + 1 + spaces);
            } else if !line.starts_with(b"sep=") {
                let is_number = |field: &&[u8]| {
                    let text = String::from_utf8_lossy(field);
                    text.trim().parse::<f64>().is_ok()
                };
                let is_row = |separators: &[u8]| {
                    let fields: Vec<&[u8]> = line.split(|byte| separators.contains(byte)).collect();
                    2 * fields.iter().filter(|field| is_number(field)).count() >= fields.len()
                };
                let is_row = is_row(b",;\t|") || is_row(b" ");
                if let Some(header) = header.filter(|_| is_row) {
                    self.taken = header;
                }
                break;
            }
            self.taken += end + 1;
        }
        self.drop_head(self.taken);
        self.taken = 0;
    }

    fn drop_head(&mut self, bytes: usize) {
        self.line += self.head.drain(..bytes).filter(|byte| *byte == b'\n').count();
    }

    /// The number of the line that ends in front of a byte, or with it. Calls are in ascending
    /// order.
    pub(super) fn line_before(&mut self, byte: u64) -> usize {
        while self.line_ends.front().is_some_and(|end| end + 1 < byte) {
            self.line_ends.pop_front();
            self.line += 1;
        }
        self.line
    }

    fn note_line_ends(&mut self, read: &[u8]) {
        for (at, byte) in (self.bytes..).zip(read) {
            if self.after_return && *byte != b'\n' {
                self.line_ends.push_back(at - 1);
            }
            self.after_return = *byte == b'\r';
            if *byte == b'\n' {
                self.line_ends.push_back(at);
            }
        }
    }

    /// The error of a text after some complete rows.
    pub(super) fn explain(&self, path: &Path, rows: usize, error: csv::Error) -> TrialError {
        let allowed = self.allowed;
        match self.zipped {
            _ if !self.is_too_long() => {}
            _ if self.bytes <= allowed => return row_too_long(path, rows),
            Some(found) if allowed < MAX_TEXT_BYTES => {
                let what = format!(
                    "more than {allowed} bytes of text in {found} bytes of gzip, allowed are \
                     {MAX_EXPANSION} for each, and {FREE_TEXT_BYTES} in any case. Decompress it \
                     first"
                );
                return TrialError::new(path, Fault::Expands, what);
            }
            _ => {
                let what = format!("more than {MAX_TEXT_BYTES} bytes of text. Split the recording");
                return TrialError::new(path, Fault::TooLong, what);
            }
        }
        let is_zipped = self.zipped.is_some();
        let source = match error.into_kind() {
            csv::ErrorKind::Io(source) => source,
            // Neither occurs: rows are read as bytes, and may have any length.
            other => io::Error::other(format!("{other:?}")),
        };
        match source.kind() {
            ErrorKind::UnexpectedEof if is_zipped => {
                truncated(path, "the gzip stream has no end", rows)
            }
            ErrorKind::InvalidInput | ErrorKind::InvalidData if is_zipped => {
                let what = format!("damaged gzip data after {rows} complete rows: {source}");
                TrialError::new(path, Fault::Gzip, what)
            }
            _ => TrialError::io(path)(source),
        }
    }
}

/// A file that ends too early.
pub(super) fn truncated(path: &Path, missing: &str, rows: usize) -> TrialError {
    let what = format!(
        "truncated: {missing} after {rows} complete rows. Copy the file again, or leave it out of \
         the command"
    );
    TrialError::new(path, Fault::Truncated, what)
}

/// A file of another format, and how it is converted.
pub(super) fn of_another_kind(path: &Path, found: &str) -> TrialError {
    let what = format!(
        "found {found}, expected a .npy array of shape (n, 11), a CSV, plain or .gz, or a capture \
         (.mcap)"
    );
    TrialError::new(path, Fault::Kind, what)
}

fn row_too_long(path: &Path, rows: usize) -> TrialError {
    let what = format!("more than {MAX_ROW_BYTES} bytes in the row after {rows} whole rows");
    TrialError::new(path, Fault::RowTooLong, what)
}

impl Read for Meter {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = match self.head.get(self.taken..).filter(|rest| !rest.is_empty()) {
            Some(mut rest) => {
                let read = rest.read(buffer)?;
                self.taken += read;
                read
            }
            None => match self.failed.take() {
                Some(error) => return Err(error),
                None => self.source.read(buffer)?,
            },
        };
        self.ended = read == 0;
        self.note_line_ends(&buffer[..read]);
        self.bytes += read as u64;
        self.row_bytes += read as u64;
        if self.is_too_long() {
            return Err(io::Error::other("too long"));
        }
        if let Some(last) = buffer[..read].last() {
            self.last = *last;
        }
        Ok(read)
    }
}
