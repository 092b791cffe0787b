//! Recovery of corrupt files, with an account of what is lost.
//!
//! Everything readable is copied in its order, with new indexes and checksums. Losses are counted
//! by kind: by the file's own statistics if they are readable, else by the message indexes after
//! corrupt chunks. Otherwise they are reported as unknown.

mod ledger;

use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom, Write};

use mcap::records::{Channel, Footer, MessageHeader, Metadata, Record, Statistics, op};
use mcap::{Attachment, Compression, McapError, WriteOptions};

use crate::definitions::{Definitions, SchemaText};
use crate::scan::{Event, Raw, RecordLocation, Scan, ScanError, kind_name};
use crate::writer::reason;
use ledger::Ledger;
pub use ledger::{Counts, Recovery, Trouble};

/// Name of the metadata record that describes the recovery.
pub const RECOVERED: &str = "joulebus.recovered";
/// Uncompressed size at which a chunk is written, bytes.
const CHUNK_BYTES: u64 = 1 << 20;
/// Footer and magic at the end of a file, bytes.
const TAIL_BYTES: u64 = 37;

/// Errors of a recovery.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum RecoverError {
    /// The input is not an MCAP file, or cannot be read.
    #[error(transparent)]
    Read(#[from] ScanError),
    /// The result cannot be written.
    #[error("cannot write: {reason}")]
    Write { reason: String },
}

impl From<io::Error> for RecoverError {
    /// An error of the result.
    fn from(error: io::Error) -> Self {
        Self::Write { reason: error.to_string() }
    }
}

/// Copies everything readable of `input` to `output` as a valid file.
///
/// Messages of a chunk with a wrong checksum are copied and counted as suspect, because the corrupt
/// ones cannot be identified. A metadata record of the result, [`RECOVERED`], states the counts.
///
/// The first bytes may be damaged, too: a file is no MCAP file if nothing in it can be recovered.
///
/// # Errors
/// [`RecoverError`]: the input is not an MCAP file, or one of the two files fails.
pub fn recover<R, W>(mut input: R, output: W) -> Result<(Recovery, W), RecoverError>
where
    R: Read + Seek,
    W: Write + Seek,
{
    let (profile, compression) = beginning(&mut input)?;
    let summary = match read_summary(&mut input) {
        Some(summary) => summary,
        None => told(&mut input)?,
    };
    let library = concat!("joulebus ", env!("CARGO_PKG_VERSION"), " recover");
    // Seeking back in a file that could not grow makes the library panic.
    let writer = WriteOptions::new()
        .compression(compression)
        .profile(profile)
        .library(library)
        .chunk_size(Some(CHUNK_BYTES))
        .disable_seeking(true)
        .create(output)
        .map_err(failed)?;
    let (mut scan, not_mcap) = Scan::anyway(input)?;
    let mut rescue = Rescue { writer, ledger: Ledger::default(), summary, known: BTreeMap::new() };
    if let Some(not_mcap) = &not_mcap {
        rescue.ledger.broken(not_mcap);
        if let Some(skipped) = scan.resume()? {
            rescue.ledger.skipped(skipped);
        }
    }
    loop {
        match scan.next_event() {
            Ok(Some(event)) => rescue.take(event)?,
            Ok(None) => break,
            Err(error @ ScanError::Io { .. }) => return Err(error.into()),
            Err(error) => {
                rescue.ledger.broken(&error);
                match scan.resume()? {
                    Some(skipped) => rescue.ledger.skipped(skipped),
                    None => break,
                }
            }
        }
    }
    match not_mcap {
        Some(not_mcap) if rescue.ledger.is_empty() => Err(not_mcap.into()),
        _ => rescue.finish(),
    }
}

/// Calls `take` with every event up to the one for which it is true, whatever the damage.
fn walk<R: Read + Seek>(
    mut scan: Scan<R>,
    mut take: impl FnMut(Event<'_>) -> bool,
) -> Result<(), ScanError> {
    // Where the first bytes are not those of an MCAP file, the first record is searched.
    scan.resume()?;
    loop {
        match scan.next_event() {
            Ok(Some(event)) => {
                if take(event) {
                    return Ok(());
                }
            }
            Ok(None) => return Ok(()),
            Err(error @ ScanError::Io { .. }) => return Err(error),
            Err(_) => {
                if scan.resume()?.is_none() {
                    return Ok(());
                }
            }
        }
    }
}

/// The file's profile, and the compression of its first chunk.
fn beginning(input: &mut (impl Read + Seek)) -> Result<(String, Option<Compression>), ScanError> {
    let (mut profile, mut compression) = (String::new(), None);
    let (scan, _) = Scan::anyway(input)?;
    walk(scan, |event| match event {
        Event::ChunkBegins(frame) => {
            compression = match frame.header.compression.as_str() {
                "zstd" => Some(Compression::Zstd),
                "lz4" => Some(Compression::Lz4),
                _ => None,
            };
            true
        }
        Event::Record(raw) => {
            if let Ok(Record::Header(header)) = raw.parse() {
                profile = header.profile;
            }
            false
        }
        Event::ChunkEnds { .. } | Event::TooLong { .. } => false,
    })?;
    Ok((profile, compression))
}

/// What is known of a file without its chunks.
#[derive(Default)]
struct Summary {
    definitions: Definitions,
    statistics: Option<Statistics>,
}

impl Summary {
    fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                let schema = (header.name, header.encoding, data.into_owned());
                self.definitions.schemas.insert(header.id, schema);
            }
            Record::Channel(channel) => {
                self.definitions.channels.insert(channel.id, channel);
            }
            Record::Statistics(statistics) => self.statistics = Some(statistics),
            _ => {}
        }
    }
}

/// What the records outside of chunks tell: those of the recorder, and a summary that is whole, at
/// whatever place.
fn told(input: &mut (impl Read + Seek)) -> Result<Summary, ScanError> {
    let (mut told, mut summary) = (Definitions::default(), Summary::default());
    let mut is_whole = false;
    let (scan, _) = Scan::anyway(input)?;
    walk(scan.outside_of_chunks(), |event| {
        if let Event::Record(raw) = event
            && let Ok(record) = raw.parse()
        {
            match record {
                Record::Metadata(record) => told.add(&record),
                Record::Footer(_) => is_whole = raw.crc.is_some_and(|crc| !crc.is_wrong()),
                record => summary.take(record),
            }
        }
        false
    })?;
    let mut whole = if is_whole { summary } else { Summary::default() };
    whole.definitions.schemas.append(&mut told.schemas);
    whole.definitions.channels.append(&mut told.channels);
    Ok(whole)
}

/// Reads the summary if it is complete, in its place, and its checksum is right. It may be intact
/// where the data section is not. Without a summary there is nothing to use, and nothing to report.
fn read_summary(input: &mut (impl Read + Seek)) -> Option<Summary> {
    try_summary(input).ok().flatten()
}

fn try_summary(input: &mut (impl Read + Seek)) -> Result<Option<Summary>, ScanError> {
    let mut saved = Summary::default();
    let io = |source| ScanError::Io { place: RecordLocation { offset: 0, in_chunk: None }, source };
    let file_bytes = input.seek(SeekFrom::End(0)).map_err(io)?;
    let Some(at) = file_bytes.checked_sub(TAIL_BYTES) else {
        return Ok(None);
    };
    input.seek(SeekFrom::Start(at)).map_err(io)?;
    let mut tail = [0; TAIL_BYTES as usize];
    input.read_exact(&mut tail).map_err(io)?;
    let Ok(Record::Footer(Footer { summary_start, .. })) =
        mcap::parse_record(op::FOOTER, &tail[9..29])
    else {
        return Ok(None);
    };
    if tail[0] != op::FOOTER || summary_start == 0 || summary_start > at {
        return Ok(None);
    }
    let (mut scan, _) = Scan::anyway(input)?;
    scan.go_to(summary_start)?;
    while let Some(event) = scan.next_event()? {
        let Event::Record(raw) = event else {
            return Ok(None);
        };
        match raw.parse()? {
            Record::Footer(_) => {
                let is_sound = raw.crc.is_none_or(|crc| !crc.is_wrong());
                return Ok(is_sound.then_some(saved));
            }
            record => saved.take(record),
        }
    }
    Ok(None)
}

struct Rescue<W: Write + Seek> {
    writer: mcap::Writer<W>,
    ledger: Ledger,
    /// It is right where a chunk may be wrong.
    summary: Summary,
    /// Topics of the channels written so far.
    known: BTreeMap<u16, String>,
}

impl<W: Write + Seek> Rescue<W> {
    fn take(&mut self, event: Event<'_>) -> Result<(), RecoverError> {
        match event {
            Event::ChunkBegins(frame) => self.ledger.chunk_begins(&frame),
            Event::ChunkEnds { frame, crc } => self.ledger.chunk_ends(&frame, crc),
            Event::TooLong { place, opcode, bytes } => self.ledger.too_long(place, opcode, bytes),
            Event::Record(raw) => self.record(&raw)?,
        }
        Ok(())
    }

    fn record(&mut self, raw: &Raw<'_>) -> Result<(), RecoverError> {
        self.ledger.before(raw);
        let record = match raw.parse() {
            Ok(record) => record,
            Err(error) => {
                self.ledger.unreadable(raw.opcode, &error);
                return Ok(());
            }
        };
        match record {
            // The summary repeats both. They have already been read.
            Record::Schema { .. } | Record::Channel(_) if self.ledger.is_past_data() => {}
            Record::Message { .. } | Record::Attachment { .. } | Record::Metadata(_)
                if self.ledger.is_past_data() =>
            {
                self.ledger.misplaced(raw.place, raw.opcode);
            }
            Record::Schema { header, data } => {
                let schema = self.summary.definitions.schemas.get(&header.id).cloned();
                let schema =
                    schema.unwrap_or_else(|| (header.name, header.encoding, data.into_owned()));
                self.schema(raw.place, header.id, &schema)?;
            }
            Record::Channel(channel) => {
                let known = self.summary.definitions.channels.get(&channel.id).cloned();
                self.channel(raw.place, known.unwrap_or(channel))?;
            }
            Record::Message { header, data } => self.message(raw.place, &header, &data)?,
            Record::Attachment { header, data, .. } => {
                let attachment = Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                };
                self.writer.attach(&attachment).map_err(failed)?;
                self.ledger.found.attachments.recovered += 1;
            }
            Record::Metadata(metadata) => {
                self.writer.write_metadata(&metadata).map_err(failed)?;
                self.ledger.found.metadata.recovered += 1;
            }
            Record::MessageIndex(index) => self.ledger.message_index(index.records.len() as u64),
            Record::DataEnd(_) => self.ledger.data_ends(raw.crc),
            Record::Footer(_) => self.ledger.footer(raw.place, raw.crc),
            Record::Unknown { opcode, .. } => {
                let what = format!("{} {opcode:#04x} is omitted", kind_name(opcode));
                self.ledger.other_lost(raw.place, what);
            }
            // Indexes and statistics are recreated.
            _ => {}
        }
        Ok(())
    }

    fn schema(
        &mut self,
        place: RecordLocation,
        id: u16,
        (name, encoding, data): &SchemaText,
    ) -> Result<(), RecoverError> {
        let added = self.writer.add_schema_with_id(id, name, encoding, data);
        match refused(added)? {
            None => self.ledger.schema(id),
            Some(why) => {
                self.ledger.found.schemas.lost += 1;
                self.ledger.found.trouble(place, format!("schema {id} ({name}): {why}"));
            }
        }
        Ok(())
    }

    fn channel(&mut self, place: RecordLocation, channel: Channel) -> Result<(), RecoverError> {
        let schema = channel.schema_id;
        if !self.ledger.has_schema(schema)
            && let Some(saved) = self.summary.definitions.schemas.get(&schema).cloned()
        {
            self.schema(place, schema, &saved)?;
        }
        let added = self.writer.add_channel_with_id(
            channel.id,
            schema,
            &channel.topic,
            &channel.message_encoding,
            &channel.metadata,
        );
        match refused(added)? {
            None => {
                if self.known.insert(channel.id, channel.topic).is_none() {
                    self.ledger.found.channels.recovered += 1;
                }
            }
            Some(why) => {
                let what = format!("channel {} ({}): {why}", channel.id, channel.topic);
                self.ledger.found.channels.lost += 1;
                self.ledger.found.trouble(place, what);
            }
        }
        Ok(())
    }

    fn message(
        &mut self,
        place: RecordLocation,
        header: &MessageHeader,
        data: &[u8],
    ) -> Result<(), RecoverError> {
        let id = header.channel_id;
        if !self.known.contains_key(&id)
            && let Some(saved) = self.summary.definitions.channels.get(&id).cloned()
        {
            self.channel(place, saved)?;
        }
        let Some(topic) = self.known.get(&id) else {
            self.ledger.orphan(place, id);
            return Ok(());
        };
        self.ledger.message(topic);
        self.writer.write_to_known_channel(header, data).map_err(failed)
    }

    fn finish(mut self) -> Result<(Recovery, W), RecoverError> {
        let statistics = self.summary.statistics.take();
        let recovery = self.ledger.clone().settle(statistics.as_ref());
        if !recovery.is_clean() {
            let note = Metadata { name: RECOVERED.to_owned(), metadata: recovery.notes() };
            self.writer.write_metadata(&note).map_err(failed)?;
        }
        self.writer.finish().map_err(failed)?;
        Ok((recovery, self.writer.into_inner()))
    }
}

/// The writer's reason to refuse a schema or a channel. An error if it cannot write at all.
fn refused(added: Result<u16, McapError>) -> Result<Option<String>, RecoverError> {
    match added {
        Ok(_) => Ok(None),
        Err(error @ (McapError::Io(_) | McapError::AttemptedWriteAfterFailure)) => {
            Err(failed(error))
        }
        Err(error) => Ok(Some(error.to_string())),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
fn failed(error: McapError) -> RecoverError {
    RecoverError::Write { reason: reason(&error) }
}
