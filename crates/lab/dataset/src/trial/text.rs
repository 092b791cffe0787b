//! The table as CSV with a header, plain or compressed.

use std::io::{self, ErrorKind, Read};
use std::ops::RangeInclusive;
use std::path::Path;

use csv::ByteRecord;
use flate2::bufread::MultiGzDecoder;
use joulebus_files::foreign;
use joulebus_plausibility::charging_of_text;

use super::TrialError;
use super::limits::{FREE_TEXT_BYTES, InMemory, MAX_EXPANSION, MAX_ROW_BYTES, MAX_TEXT_BYTES};
use super::moment::{self, Midnights, TimeForm};
use super::names::{ColumnMap, Found, Quantity, accepted, is_unit, suggestion};
use super::table::{
    Cell, Column, LeftOut, SourceColumn, Table, Tables, Take, check_value, is_time,
};

/// Reads the table part by part. `zipped`: the bytes are gzip, with the size of the file.
pub(super) fn read(
    path: &Path,
    source: Box<dyn Read>,
    zipped: Option<u64>,
    map: &ColumnMap,
    in_memory: InMemory,
    take: &mut Take<'_>,
) -> Result<(), TrialError> {
    let (source, allowed): (Box<dyn Read>, u64) = match zipped {
        Some(bytes) => {
            let source = MultiGzDecoder::new(io::BufReader::new(source));
            let allowed = bytes.saturating_mul(MAX_EXPANSION).max(FREE_TEXT_BYTES);
            (Box::new(source), allowed.min(MAX_TEXT_BYTES))
        }
        None => (source, MAX_TEXT_BYTES),
    };
    let mut meter = Meter {
        source,
        head: Vec::new(),
        taken: 0,
        failed: None,
        ended: false,
        bytes: 0,
        allowed,
        row_bytes: 0,
        last: b'\n',
    };
    let start = Start::find(path, &mut meter, zipped, map)?;
    let Start { separator, layout, sources, ignored_columns, decimal_comma, understood } = start;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .flexible(true)
        .delimiter(separator)
        .from_reader(meter);
    let header = match reader.byte_headers() {
        Ok(header) => header.clone(),
        Err(error) => return Err(explain(path, zipped, reader.get_ref(), 0, error)),
    };
    let mut numbers = Numbers { decimal_comma, has_point: false };
    let mut times = Times::default();
    let mut tables = Tables::default();
    let mut record = ByteRecord::new();
    let (mut rows, mut broken) = (0, 0);
    let mut notes = Notes { understood, left_out: LeftOut::default() };
    let (mut refused, mut headers) = (None, Vec::new());
    loop {
        let cell = Cell { path, row: rows + 1 };
        let taken = match reader.read_byte_record(&mut record) {
            Ok(false) => break,
            Ok(true) => {
                let meter = reader.get_ref();
                let cut = meter.ended && !meter.ends_in_line_break();
                let cut = cut && (map.leaves_out() || record.len() < header.len());
                match no_row(&record, &header, layout.robot, (cell.row, separator), cut) {
                    Some(what) => {
                        Err(TrialError::Line { path: path.to_owned(), row: cell.row, what })
                    }
                    None => layout.take_row(cell, &record, &mut numbers, &mut times, &mut tables),
                }
            }
            Err(error) => {
                let error = explain(path, zipped, reader.get_ref(), rows, error);
                match error {
                    TrialError::Truncated { missing: what, .. }
                    | TrialError::Gzip { detail: what, .. }
                        if map.leaves_out() && rows > 0 =>
                    {
                        notes.left_out.add(cell.row, what);
                        break;
                    }
                    error => return Err(error),
                }
            }
        };
        match taken {
            Err(error) if map.leaves_out() && error.is_of_lines() => {
                if record == header {
                    headers.push(cell.row as u32);
                }
                notes.left_out.add(cell.row, error.of_the_line());
                broken += 1;
                refused.get_or_insert(error);
            }
            taken => taken?,
        }
        rows += 1;
        reader.get_mut().row_bytes = 0;
        if let Some(mut parts) = tables.complete(path, in_memory)? {
            for table in &mut parts {
                table.ignored_columns.clone_from(&ignored_columns);
                table.headers.clone_from(&headers);
            }
            times.finish(path, &mut parts, &layout.time_name, &mut notes.understood)?;
            let parts = layout.finish(parts, &sources, &times, &mut notes);
            if parts.into_iter().try_for_each(&mut *take).is_break() {
                return Ok(());
            }
        }
    }
    // A file of other lines is none with a few broken ones.
    if let Some(error) = refused.filter(|_| broken * 2 > rows) {
        return Err(error);
    }
    let ends_whole = reader.get_ref().ends_in_line_break();
    let no_final_line_break = !ends_whole && notes.left_out.lines == 0;
    let mut tables = tables.finish(path, &ignored_columns, no_final_line_break);
    times.finish(path, &mut tables, &layout.time_name, &mut notes.understood)?;
    times.note_midnights(&layout.time_name, &mut notes.understood);
    if numbers.decimal_comma == Some(true) {
        let what = "its numbers have a decimal comma";
        notes.understood.push(what.to_owned());
    }
    for table in &mut tables {
        table.headers.clone_from(&headers);
    }
    let tables = layout.finish(tables, &sources, &times, &mut notes);
    // Whether it wants more makes no difference.
    let _ = tables.into_iter().try_for_each(take);
    Ok(())
}

/// Notes on the text that no table has yet.
struct Notes {
    understood: Vec<String>,
    left_out: LeftOut,
}

/// Describes a line that is no row.
fn no_row(
    record: &ByteRecord,
    header: &ByteRecord,
    robot: Option<usize>,
    (row, separator): (usize, u8),
    cut: bool,
) -> Option<String> {
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
        line.split(|byte| *byte == separator).count() >= header.len().max(2)
            && line.iter().any(u8::is_ascii_digit)
    };
    let lines = record.iter().flat_map(|field| field.split(|byte| *byte == b'\n').skip(1));
    let swallowed = lines.filter(is_row).count();
    if swallowed > 0 {
        Some(format!("a quote that is not closed: {swallowed} rows are in its text"))
    } else if nul_bytes > 0 {
        Some(format!("{nul_bytes} NUL bytes, as a loss of power leaves them"))
    } else if record == header {
        Some("the header again: a second recording was appended".to_owned())
    } else if is_comment(first) && (robot != Some(0) || record.len() != header.len()) {
        // A robot may be named #3.
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

/// Beginning of a text: the separator of its fields, and their layout.
struct Start {
    separator: u8,
    layout: Layout,
    sources: Vec<SourceColumn>,
    ignored_columns: Vec<String>,
    decimal_comma: Option<bool>,
    understood: Vec<String>,
}

impl Start {
    /// Finds the separator with which the header names what a trial needs.
    fn find(
        path: &Path,
        meter: &mut Meter,
        zipped: Option<u64>,
        map: &ColumnMap,
    ) -> Result<Self, TrialError> {
        meter.fill_head();
        if let Some(foreign) = foreign::recognise(&meter.head) {
            return Err(TrialError::Kind {
                path: path.to_owned(),
                found: match zipped.is_some() {
                    true => format!("{} in gzip (decompress it first)", foreign.what),
                    false => foreign.to_string(),
                },
            });
        }
        if !meter.head.contains(&b'\n')
            && let Some(error) = meter.failed.take()
        {
            return Err(explain(path, zipped, meter, 0, error.into()));
        }
        if meter.head.len() as u64 >= MAX_ROW_BYTES && !meter.head.contains(&b'\n') {
            return Err(TrialError::RowTooLong { path: path.to_owned(), rows: 0 });
        }
        meter.drop_preamble();
        let mut first = None;
        // Other programs write what they measured in lines above the header.
        for line in 1..=MAX_HEADER_LINE {
            match Self::at_header(path, meter, map) {
                Ok(mut start) => {
                    if line > 1 {
                        let what =
                            format!("its header is line {line}. Those above are passed over");
                        start.understood.push(what);
                    }
                    return Ok(start);
                }
                Err(error) => first.get_or_insert(error),
            };
            if !meter.drop_line() {
                break;
            }
        }
        // A loop that found no header has an error.
        Err(first.unwrap_or_else(|| TrialError::Empty { path: path.to_owned() }))
    }

    /// Reads the header at the beginning of the text.
    fn at_header(path: &Path, meter: &Meter, map: &ColumnMap) -> Result<Self, TrialError> {
        let mut best: Option<(usize, TrialError)> = None;
        for separator in [b',', b';', b'\t', b'|', b' '] {
            let (header, sample) = sampled(&meter.head, separator);
            // Words of a sentence are no columns.
            let is_table = !sample.is_empty() && sample.iter().all(|row| row.len() == header.len());
            if separator == b' ' && !is_table {
                continue;
            }
            let layout = Layout::find(path, &header, &sample, map);
            let (layout, sources, ignored_columns) = match layout {
                Ok(found) => found,
                Err(error) => {
                    let is_more = best.as_ref().is_none_or(|(fields, _)| header.len() > *fields);
                    if is_more && separator != b' ' {
                        best = Some((header.len(), error));
                    }
                    continue;
                }
            };
            let mut numbers = Numbers { decimal_comma: None, has_point: false };
            let is_plain = separator == b',';
            let understood = (!is_plain)
                .then(|| format!("its fields are separated by {:?}", char::from(separator)));
            for field in sample.iter().flat_map(ByteRecord::iter) {
                let _ = numbers.parse(field);
            }
            // Between commas it is in quotes, and of all numbers or of none.
            let is_mixed = separator == b',' && numbers.has_point;
            let decimal_comma = if is_mixed { Some(false) } else { numbers.decimal_comma };
            return Ok(Self {
                separator,
                layout,
                sources,
                ignored_columns,
                decimal_comma,
                understood: understood.into_iter().collect(),
            });
        }
        // There are five separators, and each but the last has an error.
        Err(best.map_or_else(|| TrialError::Empty { path: path.to_owned() }, |(_, error)| error))
    }
}

/// The header, and the first rows that are whole.
fn sampled(head: &[u8], separator: u8) -> (ByteRecord, Vec<ByteRecord>) {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .flexible(true)
        .has_headers(false)
        .delimiter(separator)
        .from_reader(head);
    let mut records = reader.byte_records().map_while(Result::ok);
    let header = records.next().unwrap_or_default();
    (header, records.take(SAMPLED_ROWS).collect())
}

/// The line, at most, that has the names of the columns.
const MAX_HEADER_LINE: usize = 32;
/// Rows that show how a text is written.
const SAMPLED_ROWS: usize = 200;
/// Bytes in which they are looked for.
const HEAD_BYTES: u64 = 64 << 10;

/// Form of the numbers of a text.
struct Numbers {
    /// True if a comma is in front of the fraction. Unknown until a number shows it.
    decimal_comma: Option<bool>,
    /// True if a number had a point.
    has_point: bool,
}

impl Numbers {
    /// The number in a field, NaN for one that means that there is none, or what is allowed.
    fn parse(&mut self, field: &[u8]) -> Result<f64, &'static str> {
        const ALLOWED: &str = "a number, NaN, or nothing";
        if is_missing(field) {
            return Ok(f64::NAN);
        }
        let text = std::str::from_utf8(field).map_err(|_| ALLOWED)?;
        if let Ok(number) = text.parse() {
            self.has_point |= text.contains('.');
            if self.decimal_comma == Some(true) && is_thousands(text) {
                return Err("a number with a decimal comma; a point could separate thousands here");
            }
            return Ok(number);
        }
        let comma = text.split_once(',').filter(|_| self.decimal_comma != Some(false));
        let (whole, fraction) = comma.ok_or(ALLOWED)?;
        let digits = whole.trim_start_matches(['-', '+']);
        // Thousands have one to three digits in front of them, and no zero first.
        let is_fraction =
            fraction.len() != 3 || !(1..=3).contains(&digits.len()) || digits.starts_with('0');
        if text.contains('.') || !(is_fraction || self.decimal_comma == Some(true)) {
            return Err("a number with a point. A comma could separate thousands here");
        }
        let number = format!("{whole}.{fraction}").parse().map_err(|_| ALLOWED)?;
        self.decimal_comma = Some(true);
        Ok(number)
    }
}

/// True if a point in a number could separate thousands: one to three digits in front, three
/// behind.
fn is_thousands(text: &str) -> bool {
    let digits = text.trim_start_matches(['-', '+']);
    digits.split_once('.').is_some_and(|(whole, rest)| {
        (1..=3).contains(&whole.len()) && !whole.starts_with('0') && rest.len() == 3
    })
}

/// The number in front of the unit of its column: `12.1 V`.
fn without_unit(field: &[u8], column: Column, factor: f64) -> Option<&[u8]> {
    let is_unit_letter = |byte: &u8| byte.is_ascii_alphabetic();
    let end = field.iter().rposition(|byte| !is_unit_letter(byte))? + 1;
    let (number, unit) = field.split_at(end);
    let unit = std::str::from_utf8(unit).ok()?;
    is_unit(column, unit, factor).then(|| number.trim_ascii())
}

/// True if a field states that there is no value.
fn is_missing(field: &[u8]) -> bool {
    const WORDS: [&str; 16] = [
        "nan",
        "na",
        "n/a",
        "<na>",
        "#n/a",
        "nat",
        "null",
        "none",
        "nil",
        "-",
        "--",
        "-nan(ind)",
        "nan(ind)",
        "-1.#ind",
        "1.#qnan",
        "unavailable",
    ];
    let is_word = |word: &&str| field.eq_ignore_ascii_case(word.as_bytes());
    field.is_empty() || WORDS.iter().any(is_word)
}

/// Form of the times of a text.
#[derive(Default)]
struct Times {
    form: Option<TimeForm>,
    /// True if they are numbers of a unit that their size shows, when all are known.
    is_epoch: bool,
    /// This unit, and how many make a second.
    unit: Option<(&'static str, f64)>,
    /// True if they are whole numbers, and nothing states their unit.
    is_unstated: bool,
    /// State of the times of day, over all robots.
    midnights: Midnights,
}

impl Times {
    /// The time in a row, s, or in a unit that is not known yet.
    fn take(
        &mut self,
        cell: Cell<'_>,
        layout: &Layout,
        record: &ByteRecord,
        numbers: &mut Numbers,
    ) -> Result<f64, TrialError> {
        let name = &layout.time_name;
        let field = |position: usize| record.get(position).unwrap_or_default();
        let refuse = |field: &[u8], allowed: &str| {
            let found = String::from_utf8_lossy(field);
            cell.refuse(name, found.chars().take(60).collect::<String>(), allowed)
        };
        let allowed =
            || format!("a number of seconds within ±4e9, or a time such as {}", moment::ALLOWED);
        let (position, factor, states_unit) = match layout.time {
            TimeColumns::One(found) => (found.position, found.factor, found.states_unit),
            TimeColumns::Pair(seconds, nanoseconds) => {
                let mut part = |position| {
                    let found = numbers.parse(field(position));
                    found.map_err(|allowed| refuse(field(position), allowed))
                };
                let time_s = part(seconds)? + part(nanoseconds)? * 1e-9;
                return match is_time(time_s) {
                    true => Ok(time_s),
                    false => Err(refuse(field(seconds), &allowed())),
                };
            }
        };
        let text = field(position);
        let (form, time_s) = match numbers.parse(text) {
            Ok(number) => (TimeForm::Number, number * factor),
            Err(_) => {
                let parsed = std::str::from_utf8(text).ok().and_then(moment::parse);
                parsed.ok_or_else(|| refuse(text, &allowed()))?
            }
        };
        let is_first = self.form.is_none();
        if *self.form.get_or_insert(form) != form {
            return Err(refuse(text, "a time that is written as in the first row"));
        }
        if is_first && form == TimeForm::Number && !states_unit {
            self.is_epoch = time_s.abs() >= EPOCHS[0].1 * MIN_EPOCH_S;
            self.is_unstated = true;
        }
        self.is_unstated &= time_s.fract() == 0.0;
        match is_time(time_s) || (self.is_epoch && time_s.is_finite()) {
            true if form == TimeForm::Clock => Ok(self.midnights.take(time_s)),
            true => Ok(time_s),
            false => Err(cell.refuse(name, String::from_utf8_lossy(text), many_seconds(name))),
        }
    }

    /// Turns the times of tables into seconds, in the unit of the first ones.
    fn finish(
        &mut self,
        path: &Path,
        tables: &mut [Table],
        name: &str,
        understood: &mut Vec<String>,
    ) -> Result<(), TrialError> {
        let steps = tables.iter().filter_map(|table| {
            let pairs = table.timestamp_s.windows(2);
            let steps = pairs.map(|pair| pair[1] - pair[0]);
            let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
            let middle = steps.len().checked_sub(1)? / 2;
            Some(*steps.select_nth_unstable_by(middle, f64::total_cmp).1)
        });
        let step = steps.reduce(f64::min).unwrap_or_default();
        // millis() of an Arduino at 50 to 500 Hz.
        if self.is_unstated && !self.is_epoch && EITHER_S.contains(&step) {
            let row = Cell { path, row: 1 };
            let found = format!("whole numbers that are usually {step} apart");
            return Err(row.refuse(name, found, either(name)));
        }
        if self.is_epoch {
            let all = || tables.iter().flat_map(|table| table.timestamp_s.iter().copied());
            let of_unit = |(_, per_second): &(&str, f64)| {
                let mut times_s = all().map(|time| time / per_second);
                step / per_second <= MAX_STEP_S
                    && times_s.all(|time_s| (MIN_EPOCH_S..MAX_EPOCH_S).contains(&time_s))
            };
            let found = match self.unit {
                Some(unit) => Some(unit).filter(of_unit),
                None => EPOCHS.into_iter().find(of_unit),
            };
            let Some((unit, per_second)) = found else {
                let row = Cell { path, row: 1 };
                let found = all().next().unwrap_or_default().to_string();
                return Err(row.refuse(name, found, many_seconds(name)));
            };
            for time in tables.iter_mut().flat_map(|table| &mut table.timestamp_s) {
                *time /= per_second;
            }
            if self.unit.replace((unit, per_second)).is_none() {
                understood.push(format!("{name} is read as {unit} since 1970"));
            }
        }
        Ok(())
    }

    /// Times of day that pass midnight.
    fn note_midnights(&self, name: &str, understood: &mut Vec<String>) {
        let days = self.midnights.days;
        if days > 0 {
            understood
                .push(format!("the times of {name} have no date and pass midnight {days} times"));
        }
    }
}

/// Units of times since 1970, with their number in a second.
const EPOCHS: [(&str, f64); 3] =
    [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)];
/// Times that may be taken for such: the years 1997 to 2096.
const MIN_EPOCH_S: f64 = 8.6e8;
const MAX_EPOCH_S: f64 = 4e9;
/// Longer steps are those of another unit.
const MAX_STEP_S: f64 = 3600.0;

/// Steps of whole numbers that may be seconds or milliseconds.
const EITHER_S: RangeInclusive<f64> = 2.0..=20.0;

fn either(name: &str) -> String {
    format!(
        "a unit that is stated, because these can be seconds or milliseconds: --map time_s={name}, or --map \
         time_ms={name}"
    )
}

fn many_seconds(name: &str) -> String {
    format!(
        "a number of seconds within ±4e9. If it counts milliseconds, --map time_ms={name}, and \
            time_us or time_ns for \
         smaller ones"
    )
}

/// Limits the size of the text and of each row, and records whether the text ends with a newline.
struct Meter {
    source: Box<dyn Read>,
    /// The beginning of the text, of which `taken` bytes were read.
    head: Vec<u8>,
    taken: usize,
    /// Error of reading after the head.
    failed: Option<io::Error>,
    ended: bool,
    bytes: u64,
    allowed: u64,
    /// Bytes read since the end of the last complete row.
    row_bytes: u64,
    last: u8,
}

impl Meter {
    const fn is_too_long(&self) -> bool {
        self.bytes > self.allowed || self.row_bytes > MAX_ROW_BYTES
    }

    const fn ends_in_line_break(&self) -> bool {
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
            room = if is_cut { MAX_ROW_BYTES.saturating_sub(self.head.len() as u64) } else { 0 };
            self.failed = read.err();
        }
        if self.head.starts_with(b"\xef\xbb\xbf") {
            self.taken = 3;
        }
    }

    /// Passes over a line of the beginning, if another one follows.
    fn drop_line(&mut self) -> bool {
        let end = self.head.iter().position(|byte| *byte == b'\n');
        let Some(end) = end.filter(|end| end + 1 < self.head.len()) else {
            return false;
        };
        self.head.drain(..=end);
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
        self.head.drain(..self.taken);
        self.taken = 0;
    }
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

fn explain(
    path: &Path,
    zipped: Option<u64>,
    meter: &Meter,
    rows: usize,
    error: csv::Error,
) -> TrialError {
    let (path, allowed) = (path.to_owned(), meter.allowed);
    match zipped {
        _ if !meter.is_too_long() => {}
        _ if meter.bytes <= allowed => return TrialError::RowTooLong { path, rows },
        Some(found) if allowed < MAX_TEXT_BYTES => {
            return TrialError::Expands { path, found, allowed };
        }
        _ => return TrialError::TooLong { path },
    }
    let zipped = zipped.is_some();
    let source = match error.into_kind() {
        csv::ErrorKind::Io(source) => source,
        // Neither occurs: rows are read as bytes, and may have any length.
        other => io::Error::other(format!("{other:?}")),
    };
    match source.kind() {
        ErrorKind::UnexpectedEof if zipped => {
            TrialError::Truncated { path, missing: "the gzip stream has no end".to_owned(), rows }
        }
        ErrorKind::InvalidInput | ErrorKind::InvalidData if zipped => {
            TrialError::Gzip { path, rows, detail: source.to_string() }
        }
        _ => TrialError::Io { path, source },
    }
}

/// The columns with the time of a row.
enum TimeColumns {
    One(Found),
    /// Seconds and nanoseconds.
    Pair(usize, usize),
}

/// Position of a column's value in a row.
enum Source {
    Position(usize),
    /// A value that every row has.
    Constant(f64),
}

/// Position of each column of the table in a row, its name, and the factor to the unit of the
/// layout.
struct Layout {
    fields: usize,
    /// True if the header ends with a separator.
    ends_empty: bool,
    robot: Option<usize>,
    robot_name: Option<String>,
    time: TimeColumns,
    time_name: String,
    columns: Vec<(Column, Source, f64, String)>,
    /// Position of what says whether the battery charges, and whether numbers in it are those of
    /// ROS's `power_supply_status`.
    charging: Option<(usize, bool)>,
    /// True if power is voltage times current.
    by_product: bool,
    /// Numbers that stand for no value.
    missing: Vec<f64>,
    /// The map as it applies to this file.
    map: ColumnMap,
}

impl Layout {
    fn find(
        path: &Path,
        header: &ByteRecord,
        sample: &[ByteRecord],
        map: &ColumnMap,
    ) -> Result<(Self, Vec<SourceColumn>, Vec<String>), TrialError> {
        let names = header
            .iter()
            .map(|name| String::from_utf8_lossy(name).into_owned())
            .collect::<Vec<_>>();
        let shown = || names.join(", ").chars().take(400).collect::<String>();
        if !names.is_empty() && names.iter().all(|name| name.parse::<f64>().is_ok()) {
            return Err(TrialError::NoHeader { path: path.to_owned(), found: shown() });
        }
        let map = map.of_file(&names);
        let pairs = map.time_pairs(&names);
        let absent = map.named().filter(|(quantity, name)| {
            let is_pair = *quantity == Quantity::Time && !pairs.is_empty();
            !is_pair && names.iter().all(|found| found != name)
        });
        let absent: Vec<String> =
            absent.map(|(quantity, name)| format!("{quantity}={name}")).collect();
        if !absent.is_empty() {
            return Err(TrialError::MissingColumns {
                path: path.to_owned(),
                missing: format!("mapped: {}", absent.join(", ")),
                found: shown(),
                suggestion: suggestion(&names, [true; 2]),
            });
        }
        let twice = |first: usize, second: usize| TrialError::DuplicateColumn {
            path: path.to_owned(),
            first: names[first].clone(),
            second: names[second].clone(),
        };
        let mut used = vec![false; names.len()];
        let mut find = |quantity| match map.positions(quantity, &names).as_slice() {
            [] => Ok(None),
            [one] => {
                used[one.position] = true;
                Ok(Some(*one))
            }
            [first, second, ..] => Err(twice(first.position, second.position)),
        };
        let robot = find(Quantity::Robot)?.map(|found| found.position);
        let charging = charging_column(&names);
        let robot_name = map.constant(Quantity::Robot).map(|(name, _)| name.to_owned());
        let (mut columns, mut sources) = (Vec::new(), Vec::new());
        for column in Column::ALL {
            let quantity = Quantity::Column(column);
            let constant = map.constant(quantity);
            let value =
                constant.and_then(|(text, factor)| Some((text, text.parse().ok()?, factor)));
            let (source, factor, name, states_unit) = match (value, find(quantity)?) {
                (Some((text, value, factor)), _) => {
                    (Source::Constant(value), factor, text.to_owned(), true)
                }
                (None, Some(found)) => {
                    let name = names[found.position].clone();
                    (Source::Position(found.position), found.factor, name, found.states_unit)
                }
                (None, None) => continue,
            };
            columns.push((column, source, factor, name.clone()));
            sources.push(SourceColumn { column, name, states_unit, is_mapped: map.maps(quantity) });
        }
        let in_pairs = |position: usize| {
            let mut pairs = pairs.iter();
            pairs.any(|(seconds, nanoseconds, _)| [*seconds, *nanoseconds].contains(&position))
        };
        let alone = map.positions(Quantity::Time, &names);
        let alone: Vec<Found> =
            alone.into_iter().filter(|found| !in_pairs(found.position)).collect();
        let (time, time_name) = match (alone.as_slice(), pairs.as_slice()) {
            ([one], _) => (Some(TimeColumns::One(*one)), names[one.position].clone()),
            ([], [(seconds, nanoseconds, _)]) => {
                (Some(TimeColumns::Pair(*seconds, *nanoseconds)), names[*seconds].clone())
            }
            ([], []) => {
                let index = index_with_times(&names, sample);
                (index.map(TimeColumns::One), "the first column".to_owned())
            }
            ([first, second, ..], _) => return Err(twice(first.position, second.position)),
            ([], [(first, ..), (second, ..), ..]) => return Err(twice(*first, *second)),
        };
        match &time {
            Some(TimeColumns::One(found)) => used[found.position] = true,
            Some(TimeColumns::Pair(seconds, nanoseconds)) => {
                (used[*seconds], used[*nanoseconds]) = (true, true);
            }
            None => {}
        }
        if let Some((position, _)) = charging {
            used[position] = true;
        }
        let has = |wanted| columns.iter().any(|(column, ..)| *column == wanted);
        // `v` beside `i`, and nothing else that shows that the robot moves, or what its voltage is.
        let speed = sources.iter().find(|one| one.column == Column::V && !one.is_mapped);
        if let Some(speed) = speed.filter(|one| one.name.eq_ignore_ascii_case("v"))
            && !has(Column::Voltage)
            && !has(Column::Omega)
        {
            let current = sources.iter().find(|one| one.column == Column::Current);
            let current = current.map(|one| one.name.as_str());
            let is_i = |name: &&String| {
                let name = name.to_lowercase();
                name == "i" || name.starts_with("i_") || name.starts_with("current")
            };
            let current = current.or(names.iter().find(is_i).map(String::as_str));
            if let Some(beside) = current {
                return Err(TrialError::SpeedOrVoltage {
                    path: path.to_owned(),
                    column: speed.name.clone(),
                    beside: beside.to_owned(),
                });
            }
        }
        let by_product = !has(Column::Power) && has(Column::Voltage) && has(Column::Current);
        let mut missing = Vec::new();
        if time.is_none() {
            missing.push(accepted(Quantity::Time));
        }
        if !has(Column::Power) && !by_product {
            missing.push(format!(
                "{}, or voltage and current",
                accepted(Quantity::Column(Column::Power))
            ));
        }
        let lacks = [time.is_none(), !has(Column::Power) && !by_product];
        let Some(time) = time.filter(|_| missing.is_empty()) else {
            return Err(TrialError::MissingColumns {
                path: path.to_owned(),
                missing: missing.join(" and "),
                found: shown(),
                suggestion: suggestion(&names, lacks),
            });
        };
        let layout = Self {
            fields: names.len(),
            ends_empty: names.last().is_some_and(String::is_empty),
            robot,
            robot_name,
            time,
            time_name,
            columns,
            charging,
            by_product,
            missing: map.missing(),
            map,
        };
        // An index that a program wrote in front of the table is no column that anybody misses.
        let is_index = |at: usize, name: &str| name.is_empty() || (at == 0 && name == "Unnamed: 0");
        let ignored_columns = names
            .into_iter()
            .zip(used)
            .enumerate()
            .filter_map(|(at, (name, used))| (!used && !is_index(at, &name)).then_some(name))
            .collect();
        Ok((layout, sources, ignored_columns))
    }

    /// Adds what tables state of their text. Of several the first has the notes.
    fn finish(
        &self,
        mut tables: Vec<Table>,
        sources: &[SourceColumn],
        times: &Times,
        notes: &mut Notes,
    ) -> Vec<Table> {
        for table in &mut tables {
            if let Some(joined) = table.join_sparse(self.by_product)
                && !notes.understood.contains(&joined)
            {
                notes.understood.push(joined);
            }
            table.sources = sources.to_vec();
            let is_number = times.form == Some(TimeForm::Number);
            table.time_name = is_number.then(|| self.time_name.clone());
            table.states_time_unit = match &self.time {
                TimeColumns::One(found) => found.states_unit || times.is_epoch,
                TimeColumns::Pair(..) => true,
            };
        }
        if let Some(first) = tables.first_mut() {
            first.left_out = std::mem::take(&mut notes.left_out);
            first.understood = std::mem::take(&mut notes.understood);
        }
        self.map.turn_as_configured(&mut tables);
        tables
    }

    /// Takes a row, or nothing of it.
    fn take_row(
        &self,
        cell: Cell<'_>,
        record: &ByteRecord,
        numbers: &mut Numbers,
        times: &mut Times,
        tables: &mut Tables,
    ) -> Result<(), TrialError> {
        let fields = match record.len() {
            // A separator at the end of the rows or of the header alone.
            found if found == self.fields + 1 && record.iter().next_back() == Some(b"") => {
                self.fields
            }
            found if found + 1 == self.fields && self.ends_empty => self.fields,
            found => found,
        };
        if fields != self.fields {
            return Err(TrialError::FieldCount {
                path: cell.path.to_owned(),
                row: cell.row,
                found: fields,
                expected: self.fields,
            });
        }
        let mut values = [f64::NAN; Column::ALL.len()];
        for (column, source, factor, name) in &self.columns {
            let value = match source {
                Source::Constant(value) => value * factor,
                Source::Position(position) => {
                    let field = record.get(*position).unwrap_or_default();
                    let parsed = numbers.parse(field).or_else(|allowed| {
                        let bare = without_unit(field, *column, *factor).ok_or(allowed)?;
                        numbers.parse(bare)
                    });
                    // `96%` is that, whatever the name of the column is.
                    let percent = field.strip_suffix(b"%").filter(|_| *column == Column::Soc);
                    let percent = percent.and_then(|bare| numbers.parse(bare.trim_ascii()).ok());
                    if let Some(percent) = percent {
                        values[*column as usize] = percent * 0.01;
                        continue;
                    }
                    let value = parsed.map_err(|allowed| {
                        let found = String::from_utf8_lossy(field);
                        cell.refuse(name, found.chars().take(60).collect::<String>(), allowed)
                    })?;
                    let is_unknown = self.missing.contains(&value)
                        // ROS: the charge is not measured.
                        || (*column == Column::Soc && value == -1.0);
                    if is_unknown { f64::NAN } else { value * factor }
                }
            };
            check_value(cell, name, *column, column.si(value))?;
            values[*column as usize] = value;
        }
        let time_s = times.take(cell, self, record, numbers)?;
        let name = match (&self.robot_name, self.robot) {
            (Some(name), _) => name.clone(),
            (None, Some(position)) => robot_name(record.get(position).unwrap_or_default()),
            (None, None) => String::new(),
        };
        let product = self.by_product.then_some(Column::Power);
        if let Some(power) = product {
            let [voltage_mv, current_ma] =
                [Column::Voltage, Column::Current].map(|column| values[column as usize]);
            let power_mw = voltage_mv * current_ma / 1000.0;
            check_value(cell, power.name(), power, power.si(power_mw))?;
            values[power as usize] = power_mw;
        }
        let charging = self.charging.and_then(|(position, is_status)| {
            let text = std::str::from_utf8(record.get(position)?).ok()?;
            charging_of_text(text, is_status)
        });
        let table = tables.of(cell, &name)?;
        table.push_any_time(cell, time_s)?;
        // Whether the meter is the battery's or the robot's is not known.
        if charging == Some(true) {
            values[Column::Power as usize] = f64::NAN;
            table.on_charger.push(cell.row as u32);
        }
        let read = self.columns.iter().map(|(column, ..)| *column);
        for column in read.chain(product) {
            table.push_checked(column, values[column as usize]);
        }
        Ok(())
    }
}

/// The column that says whether the battery charges, and whether it is a `power_supply_status`.
fn charging_column(names: &[String]) -> Option<(usize, bool)> {
    let words = |name: &str| {
        let words = name.split(|letter: char| !letter.is_alphanumeric());
        words.filter(|word| !word.is_empty()).map(str::to_lowercase).collect::<Vec<_>>()
    };
    let is_last = |name: &str, last: &str| {
        let name = format!("_{}", words(name).join("_"));
        name.ends_with(&format!("_{last}"))
    };
    let status = names.iter().position(|name| is_last(name, "power_supply_status"));
    let says = |name: &String| is_last(name, "charging") || is_last(name, "on_charger");
    let is_status = status.map(|position| (position, true));
    is_status.or_else(|| names.iter().position(says).map(|position| (position, false)))
}

/// A robot's name. A whole number that a program wrote with a fraction is the number.
fn robot_name(field: &[u8]) -> String {
    if is_missing(field) {
        return String::new();
    }
    let name = String::from_utf8_lossy(field);
    let whole = name.split_once('.').filter(|(whole, fraction)| {
        let digits =
            |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        digits(whole) && fraction.bytes().all(|byte| byte == b'0')
    });
    whole.map_or(&*name, |(whole, _)| whole).to_owned()
}

/// A first column without a name that has times as text: pandas' index.
fn index_with_times(names: &[String], sample: &[ByteRecord]) -> Option<Found> {
    let is_index = matches!(names.first()?.as_str(), "" | "Unnamed: 0" | "index");
    let first = std::str::from_utf8(sample.first()?.get(0)?).ok()?;
    let found = Found { position: 0, factor: 1.0, states_unit: true };
    (is_index && moment::parse(first).is_some()).then_some(found)
}
