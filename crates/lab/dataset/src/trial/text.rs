//! The table as CSV with a header, plain or compressed.

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use csv::{ByteRecord, Reader};

use super::error::{Fault, TrialError};
use super::layout::{Lacking, Layout, Row};
use super::limits::InMemory;
use super::meter::Meter;
use super::names::ColumnMap;
use super::numbers::{Numbers, is_missing};
use super::proposal::propose;
use super::table::{Cell, LeftOut, Tables, Take};
use super::times::Times;

/// Reads the table part by part. `zipped`: the bytes are gzip, with the size of the file.
/// `first_line`: the number of its first line, 0 of a table that has no file.
pub(super) fn read(
    path: &Path,
    (source, zipped, first_line): (Box<dyn Read>, Option<u64>, usize),
    map: &ColumnMap,
    in_memory: InMemory,
    take: &mut Take<'_>,
) -> Result<(), TrialError> {
    let mut rows = Rows::open(path, Meter::new(source, zipped, first_line), map)?;
    let mut kept = Kept::default();
    let mut tables = Tables::default();
    while let Some(next) = rows.next() {
        let cell = Cell { path, row: rows.line };
        kept.note_line(&rows);
        let next = next.and_then(|row| {
            let pushed = rows.layout.push(cell, &row, &mut tables);
            pushed.map_err(|error| BadLine::new(cell.row, error))
        });
        let is_whole = match next {
            Ok(()) => true,
            Err(bad) if map.leaves_out() && bad.can_be_left_out(rows.row) => kept.leave_out(bad),
            Err(bad) => return Err(bad.error),
        };
        if !is_whole {
            continue;
        }
        if let Some(mut parts) = tables.complete(path, in_memory)? {
            for table in &mut parts {
                table.ignored_columns.clone_from(&rows.layout.ignored_columns);
            }
            kept.tell(&mut parts);
            kept.forget_all_but(&tables.lines());
            rows.finish(path, &mut parts, &mut kept)?;
            if parts.into_iter().try_for_each(&mut *take).is_break() {
                return Ok(());
            }
        }
    }
    // A file of other lines is none with a few broken ones.
    if let Some(error) = kept.refused.take().filter(|_| kept.broken * 2 > rows.row) {
        return Err(error);
    }
    let no_final_line_break =
        !rows.reader.get_ref().ends_in_line_break() && kept.left_out.lines == 0;
    let mut tables = tables.finish(path, &rows.layout.ignored_columns, no_final_line_break);
    kept.tell(&mut tables);
    rows.times.note(&rows.layout.time_name, &mut rows.understood);
    if rows.numbers.decimal_comma == Some(true) {
        rows.understood.push("its numbers have a decimal comma".to_owned());
    }
    rows.finish(path, &mut tables, &mut kept)?;
    // Whether it wants more makes no difference.
    let _ = tables.into_iter().try_for_each(take);
    Ok(())
}

#[derive(Default)]
struct Kept {
    left_out: LeftOut,
    /// Rows in which the header came again.
    headers: Vec<u32>,
    /// By how much lines are ahead of rows, from lines on.
    ahead: Vec<(u32, u32)>,
    /// Lines that are no rows, and the first error.
    broken: usize,
    refused: Option<TrialError>,
}

impl Kept {
    fn note_line(&mut self, rows: &Rows<'_>) {
        let ahead = rows.line.saturating_sub(rows.row) as u32;
        if self.ahead.last().is_none_or(|(_, last)| *last != ahead) {
            self.ahead.push((rows.line as u32, ahead));
        }
    }

    fn tell(&self, tables: &mut [super::Table]) {
        let ahead: Arc<[(u32, u32)]> = self.ahead.as_slice().into();
        for table in tables {
            table.headers.clone_from(&self.headers);
            table.ahead = Arc::clone(&ahead);
        }
    }

    /// Forgets what concerns only rows that were taken. `lines`: those of the others, in order.
    fn forget_all_but(&mut self, lines: &[u32]) {
        let until_now = self.ahead.last().copied();
        let of = |line: &u32| {
            let at = self.ahead.partition_point(|(from, _)| from <= line);
            at.checked_sub(1).map(|at| self.ahead[at])
        };
        let mut ahead: Vec<_> = lines.iter().filter_map(of).chain(until_now).collect();
        ahead.dedup();
        self.ahead = ahead;
        self.headers.retain(|header| lines.first().is_some_and(|first| header > first));
    }

    /// Leaves a line out. Always false: it is no whole row.
    fn leave_out(&mut self, bad: BadLine) -> bool {
        if bad.is_header {
            self.headers.push(bad.row as u32);
        }
        self.left_out.add(bad.row, bad.error.of_the_line());
        if bad.error.is_of_lines() && !bad.ends {
            self.broken += 1;
            self.refused.get_or_insert(bad.error);
        }
        false
    }
}

struct BadLine {
    row: usize,
    error: TrialError,
    is_header: bool,
    ends: bool,
}

impl BadLine {
    const fn new(row: usize, error: TrialError) -> Self {
        Self { row, error, is_header: false, ends: false }
    }

    /// True if the others may be read without it: not if there are none.
    fn can_be_left_out(&self, row: usize) -> bool {
        match self.error.fault() {
            Fault::Truncated | Fault::Gzip => row > 1,
            _ => self.error.is_of_lines(),
        }
    }
}

/// The rows of a text, one after another.
struct Rows<'a> {
    path: &'a Path,
    reader: Reader<Meter>,
    header: ByteRecord,
    record: ByteRecord,
    layout: Layout,
    numbers: Numbers,
    times: Times,
    understood: Vec<String>,
    separator: u8,
    leaves_out: bool,
    /// Number of the last row, from 1, and of its first line in the file.
    row: usize,
    line: usize,
    has_ended: bool,
}

impl Iterator for Rows<'_> {
    type Item = Result<Row, BadLine>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_ended {
            return None;
        }
        self.reader.get_mut().end_row();
        let read = self.reader.read_byte_record(&mut self.record);
        let end = self.reader.position().byte();
        let within = self.record.as_slice().iter().filter(|byte| **byte == b'\n' && read.is_ok());
        let line = self.reader.get_mut().line_before(end);
        self.line = line.saturating_sub(within.count());
        let cell = Cell { path: self.path, row: self.line };
        let bad = |error| BadLine::new(cell.row, error);
        match read {
            Ok(false) => return None,
            Ok(true) => self.row += 1,
            Err(error) => {
                let error = self.reader.get_ref().explain(self.path, self.row, error);
                self.row += 1;
                self.has_ended = true;
                return Some(Err(BadLine { ends: true, ..bad(error) }));
            }
        }
        let cut = self.reader.get_ref().is_cut()
            && (self.leaves_out || self.record.len() < self.header.len());
        if let Some(what) = self.no_row(self.row, cut) {
            let error = TrialError::new(self.path, Fault::Line, what).in_row(cell.row);
            return Some(Err(BadLine { is_header: self.record == self.header, ..bad(error) }));
        }
        let row = self.layout.row(cell, &self.record, &mut self.numbers, &mut self.times);
        Some(row.map_err(bad))
    }
}

impl<'a> Rows<'a> {
    /// Finds the header and its separator.
    fn open(path: &'a Path, mut meter: Meter, map: &ColumnMap) -> Result<Self, TrialError> {
        meter.begin(path)?;
        let mut first: Option<Refused> = None;
        // Other programs write what they measured in lines above the header.
        for line in 1..=MAX_HEADER_LINE {
            match Form::find(path, &meter, map) {
                Ok(Form { separator, layout, numbers, mut understood }) => {
                    if line > 1 {
                        let line = meter.line;
                        understood.push(format!(
                            "its header is line {line}. Those above are passed over"
                        ));
                    }
                    let mut reader = csv(separator).from_reader(meter);
                    let header = match reader.byte_headers() {
                        Ok(header) => header.clone(),
                        Err(error) => return Err(reader.get_ref().explain(path, 0, error)),
                    };
                    let times = Times::new(layout.day_first);
                    return Ok(Self {
                        path,
                        reader,
                        header,
                        record: ByteRecord::new(),
                        layout,
                        numbers,
                        times,
                        understood,
                        separator,
                        leaves_out: map.leaves_out(),
                        row: 0,
                        line: 0,
                        has_ended: false,
                    });
                }
                Err(refused) => first.get_or_insert(refused),
            };
            if !meter.drop_line() {
                break;
            }
        }
        // A loop that found no header has an error.
        Err(match first {
            None => empty(path),
            Some(Refused { error: Lacking { error, lacks: None }, .. }) => error,
            Some(Refused { error: Lacking { error, lacks: Some(lacks) }, header, sample }) => {
                let suggestion = propose(path, (&header, &sample), map, lacks);
                error.with(format!(
                    ". {suggestion} (`joulebus data check --help` lists the accepted names)"
                ))
            }
        })
    }

    /// Adds what is known of the text to tables. Of several the first has the notes.
    fn finish(
        &mut self,
        path: &Path,
        tables: &mut [super::Table],
        kept: &mut Kept,
    ) -> Result<(), TrialError> {
        self.times.finish(path, tables, &self.layout.time_name, &mut self.understood)?;
        self.layout.finish(tables, &self.times, &mut self.understood);
        if let Some(first) = tables.first_mut() {
            first.left_out = std::mem::take(&mut kept.left_out);
            first.understood = std::mem::take(&mut self.understood);
        }
        Ok(())
    }

    /// Describes a line that is no row. `cut`: it may be.
    fn no_row(&self, row: usize, cut: bool) -> Option<String> {
        let (record, header) = (&self.record, &self.header);
        let nul_bytes = record.as_slice().iter().filter(|byte| **byte == 0).count();
        let first = record.get(0).unwrap_or_default();
        let is_comment = |field: &[u8]| {
            let marks: [&[u8]; 3] = [b"#", b"%", b"//"];
            !is_missing(field) && marks.iter().any(|mark| field.starts_with(mark))
        };
        let is_text = |field: &[u8]| {
            let text = String::from_utf8_lossy(field);
            is_missing(field) || !text.contains(|letter: char| letter.is_ascii_digit())
        };
        // A quote that is not closed ends with the next one, or with the file.
        let is_row = |line: &&[u8]| {
            line.split(|byte| *byte == self.separator).count() >= header.len().max(2)
                && line.iter().any(u8::is_ascii_digit)
        };
        let lines = record.iter().flat_map(|field| field.split(|byte| *byte == b'\n').skip(1));
        let swallowed = lines.filter(is_row).count();
        // A robot may be named #3.
        let may_be_robot = self.layout.begins_with_robot() && record.len() == header.len();
        if swallowed > 0 {
            Some(format!("a quote that is not closed: {swallowed} rows are in its text"))
        } else if nul_bytes > 0 {
            Some(format!("{nul_bytes} NUL bytes, as a loss of power leaves them"))
        } else if record == header {
            Some("the header again: a second recording was appended".to_owned())
        } else if is_comment(first) && !may_be_robot {
            Some("a comment".to_owned())
        } else if record.iter().all(<[u8]>::is_empty) {
            Some("an empty line".to_owned())
        } else if row == 1 && record.iter().all(is_text) && !record.iter().all(is_missing) {
            let words: Vec<_> = record.iter().map(String::from_utf8_lossy).collect();
            let words = words.join(",").chars().take(60).collect::<String>();
            Some(format!("units or words instead of numbers ({words:?})"))
        } else if cut {
            let (found, expected) = (record.len(), header.len());
            Some(format!(
                "the last line may be cut: it has no newline, and {found} of {expected} fields"
            ))
        } else {
            None
        }
    }
}

/// The error of a file without any text.
pub(super) fn empty(path: &Path) -> TrialError {
    let what = "empty, expected a .npy array or a CSV with a header";
    TrialError::new(path, Fault::Empty, what)
}

/// The line, at most, that has the names of the columns.
const MAX_HEADER_LINE: usize = 32;
/// Rows that show how a text is written.
const SAMPLED_ROWS: usize = 200;

fn csv(separator: u8) -> csv::ReaderBuilder {
    let mut builder = csv::ReaderBuilder::new();
    builder.trim(csv::Trim::All).flexible(true).delimiter(separator);
    builder
}

struct Form {
    separator: u8,
    layout: Layout,
    numbers: Numbers,
    understood: Vec<String>,
}

/// A header that has not what a trial needs.
struct Refused {
    error: Lacking,
    header: ByteRecord,
    sample: Vec<ByteRecord>,
}

impl Form {
    /// Finds the separator with which the first line names what a trial needs.
    #[expect(clippy::result_large_err, reason = "once a file")]
    fn find(path: &Path, meter: &Meter, map: &ColumnMap) -> Result<Self, Refused> {
        let mut best: Option<Refused> = None;
        for separator in [b',', b';', b'\t', b'|', b' '] {
            let mut reader = csv(separator).has_headers(false).from_reader(&*meter.head);
            let mut records = reader.byte_records().map_while(Result::ok);
            let header = records.next().unwrap_or_default();
            let mut sample: Vec<ByteRecord> = records.take(SAMPLED_ROWS).collect();
            if meter.goes_on && sample.len() < SAMPLED_ROWS {
                // The beginning may end within it.
                sample.pop();
            }
            // Words of a sentence are no columns.
            let is_table = !sample.is_empty() && sample.iter().all(|row| row.len() == header.len());
            if separator == b' ' && !is_table {
                continue;
            }
            let layout = match Layout::find(path, &header, &sample, map) {
                Ok(layout) => layout,
                Err(error) => {
                    let is_more = best.as_ref().is_none_or(|best| header.len() > best.header.len());
                    if is_more && separator != b' ' {
                        best = Some(Refused { error, header, sample });
                    }
                    continue;
                }
            };
            let mut numbers = Numbers::default();
            for field in sample.iter().flat_map(ByteRecord::iter) {
                let _ = numbers.parse(field);
            }
            // Between commas it is in quotes, and of all numbers or of none.
            if separator == b',' && numbers.has_point {
                numbers.decimal_comma = Some(false);
            }
            let numbers = Numbers { has_point: false, ..numbers };
            let is_plain = separator == b',';
            let understood = (!is_plain)
                .then(|| format!("its fields are separated by {:?}", char::from(separator)));
            return Ok(Self {
                separator,
                layout,
                numbers,
                understood: understood.into_iter().collect(),
            });
        }
        // There are five separators, and each but the last has an error.
        Err(best.unwrap_or_else(|| Refused {
            error: empty(path).into(),
            header: ByteRecord::new(),
            sample: Vec::new(),
        }))
    }
}
