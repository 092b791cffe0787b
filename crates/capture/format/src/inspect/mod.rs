//! Inspection and validation of MCAP files.
//!
//! One pass over the whole file in bounded memory: only one small entry for each chunk, attachment
//! and metadata record grows with the file, for comparison with the indexes.

mod channel;
mod chunks;
mod finding;
mod records;
mod report;
mod summary;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};

use mcap::records::{Record, op};

use crate::definitions::CHANNELS;
use crate::scan::{ChunkFrame, Crc, Event, Raw, RecordLocation, Scan, ScanError};
use channel::Tally;
pub use channel::{ChannelReport, Sequence};
use chunks::Chunks;
pub use chunks::CompressionReport;
pub use finding::{Finding, Severity};
pub use records::{AttachmentReport, MetadataReport, SchemaReport};
pub use report::Inspection;
pub use summary::StatisticsCheck;
use summary::Summary;

/// Maximum number of findings listed. Others are only counted.
const MAX_LISTED_FINDINGS: usize = 200;
/// Maximum number of attachments and metadata records listed. Others are only counted.
const MAX_LISTED_RECORDS: usize = 1000;

/// Inspects a file.
///
/// # Errors
/// [`ScanError`] if it is not an MCAP file, or the system cannot read it. All other errors are
/// findings.
pub fn inspect(input: impl Read + Seek) -> Result<Inspection, ScanError> {
    let mut scan = Scan::new(input)?;
    let mut inspector = Inspector::new(scan.file_bytes());
    loop {
        match scan.next_event() {
            Ok(Some(event)) => inspector.take(event),
            Ok(None) => break,
            Err(error @ ScanError::Io { .. }) => return Err(error),
            Err(error) => {
                inspector.complete = false;
                inspector.error(Some(error.place()), error_words(&error));
                inspector.chunk = None;
                match scan.resume()? {
                    Some(skipped) => inspector.note_skipped(skipped.from, skipped.to),
                    None => break,
                }
            }
        }
    }
    Ok(inspector.finish())
}

/// The error, without the location that precedes every message.
fn error_words(error: &ScanError) -> String {
    let words = error.to_string();
    let place = format!("{}: ", error.place());
    words.strip_prefix(&place).unwrap_or(&words).to_owned()
}

/// The section of the file being read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Section {
    Data,
    Summary,
    Ended,
}

struct Inspector {
    file_bytes: u64,
    section: Section,
    complete: bool,
    header: Option<(String, String)>,
    records: u64,
    schemas: BTreeMap<u16, SchemaReport>,
    channels: BTreeMap<u16, Tally>,
    messages: u64,
    span_ns: Option<(u64, u64)>,
    last_log_ns: u64,
    out_of_order: u64,
    outside: u64,
    chunk: Option<chunks::Open>,
    chunks: Chunks,
    attachments: Vec<AttachmentReport>,
    metadata: Vec<MetadataReport>,
    summary: Summary,
    errors: u64,
    notes: u64,
    findings: Vec<Finding>,
}

impl Inspector {
    fn new(file_bytes: u64) -> Self {
        Self {
            file_bytes,
            section: Section::Data,
            complete: true,
            header: None,
            records: 0,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            messages: 0,
            span_ns: None,
            last_log_ns: 0,
            out_of_order: 0,
            outside: 0,
            chunk: None,
            chunks: Chunks::default(),
            attachments: Vec::new(),
            metadata: Vec::new(),
            summary: Summary::default(),
            errors: 0,
            notes: 0,
            findings: Vec::new(),
        }
    }

    fn find(&mut self, severity: Severity, place: Option<RecordLocation>, what: String) {
        match severity {
            Severity::Error => self.errors += 1,
            Severity::Note => self.notes += 1,
        }
        if self.findings.len() < MAX_LISTED_FINDINGS {
            self.findings.push(Finding { severity, place, what });
        }
    }

    fn error(&mut self, place: Option<RecordLocation>, what: impl Into<String>) {
        self.find(Severity::Error, place, what.into());
    }

    fn note(&mut self, place: Option<RecordLocation>, what: impl Into<String>) {
        self.find(Severity::Note, place, what.into());
    }

    fn note_skipped(&mut self, from: u64, to: u64) {
        let place = RecordLocation { offset: from, in_chunk: None };
        let what = format!("skipped {} bytes, up to byte {to}", to - from);
        self.note(Some(place), what);
    }

    fn take(&mut self, event: Event<'_>) {
        match event {
            Event::Record(raw) => self.record(&raw),
            Event::ChunkBegins(frame) => {
                self.records += 1;
                self.settle_indexes();
                self.chunk = Some(chunks::Open::new(&frame));
            }
            Event::ChunkEnds { frame, crc } => self.chunk_ends(&frame, crc),
            Event::TooLong { place, opcode, bytes } => {
                let kind = crate::scan::kind_name(opcode);
                let most = crate::scan::MAX_RECORD_BYTES;
                let what = format!("{kind} of {bytes} bytes was not read, at most {most} are");
                self.note(Some(place), what);
            }
        }
    }

    fn chunk_ends(&mut self, frame: &ChunkFrame, crc: Crc) {
        let place = RecordLocation { offset: frame.offset, in_chunk: None };
        if crc.is_wrong() {
            let Crc { saved, found } = crc;
            let what = format!("chunk: checksum {found:08x}, stored was {saved:08x}");
            self.error(Some(place), what);
        }
        let Some(open) = self.chunk.take() else {
            return;
        };
        if let Some(what) = open.wrong_span(frame) {
            self.error(Some(place), what);
        }
        self.chunks.add(frame, open, crc.saved == 0);
    }

    /// The message indexes of a chunk follow it directly.
    fn settle_indexes(&mut self) {
        for (place, what) in self.chunks.settle() {
            self.error(Some(place), what);
        }
    }

    fn record(&mut self, raw: &Raw<'_>) {
        self.records += 1;
        if self.section == Section::Data && self.records == 1 && raw.opcode != op::HEADER {
            self.error(Some(raw.place), "the first record is not a header");
        }
        if raw.place.in_chunk.is_none() && raw.opcode != op::MESSAGE_INDEX {
            self.settle_indexes();
        }
        let record = match raw.parse() {
            Ok(record) => record,
            Err(error) => return self.error(Some(raw.place), error_words(&error)),
        };
        let bytes = raw.body.len() as u64 + 9;
        match record {
            Record::Message { header, .. } => self.message(raw.place, &header),
            Record::Header(header) => self.header = Some((header.profile, header.library)),
            Record::Schema { header, data } => self.schema(
                raw.place,
                SchemaReport {
                    id: header.id,
                    name: header.name,
                    encoding: header.encoding,
                    bytes: data.len() as u64,
                    crc: crc32fast::hash(&data),
                },
            ),
            Record::Channel(channel) => self.channel(raw.place, channel),
            Record::MessageIndex(index) => {
                if let Some(what) = self.chunks.message_index(raw.place, bytes, &index) {
                    self.error(Some(raw.place), what);
                }
            }
            Record::Attachment { header, data, .. } => {
                self.summary.attachment(raw.place.offset, bytes, &header, data.len() as u64);
                if self.attachments.len() < MAX_LISTED_RECORDS {
                    self.attachments.push(AttachmentReport {
                        name: header.name,
                        media_type: header.media_type,
                        bytes: data.len() as u64,
                        log_ns: header.log_time,
                        create_ns: header.create_time,
                    });
                }
            }
            Record::Metadata(metadata) => {
                self.summary.metadata(raw.place.offset, bytes, &metadata.name);
                // They tell again what the report says of the channels.
                let is_listed = metadata.name != CHANNELS;
                if is_listed && self.metadata.len() < MAX_LISTED_RECORDS {
                    self.metadata
                        .push(MetadataReport { name: metadata.name, entries: metadata.metadata });
                }
            }
            Record::DataEnd(_) => {
                self.check_crc(raw, "data section");
                self.section = Section::Summary;
                self.summary.begins(raw.place.offset + bytes);
            }
            Record::Footer(footer) => {
                self.check_crc(raw, "summary");
                self.section = Section::Ended;
                let wrong = self.summary.footer(raw.place.offset, footer);
                wrong.into_iter().for_each(|what| self.error(Some(raw.place), what));
            }
            Record::Unknown { opcode, .. } => {
                let what =
                    format!("a record of opcode {opcode:#04x}, which is not defined by the format");
                self.note(Some(raw.place), what);
            }
            other => {
                if let Some(what) = self.summary.take(raw.place.offset, other, &mut self.chunks) {
                    self.error(Some(raw.place), what);
                }
            }
        }
        if self.section != Section::Data {
            self.summary.group(raw.opcode, raw.place.offset, bytes);
        }
    }

    fn check_crc(&mut self, raw: &Raw<'_>, what: &str) {
        if let Some(Crc { saved, found }) = raw.crc.filter(Crc::is_wrong) {
            let what = format!("{what}: checksum {found:08x}, stored was {saved:08x}");
            self.error(Some(raw.place), what);
        }
    }

    fn schema(&mut self, place: RecordLocation, schema: SchemaReport) {
        if schema.id == 0 {
            return self.error(Some(place), "a schema with the number 0, which means none");
        }
        match self.schemas.get(&schema.id) {
            Some(first) if *first != schema => {
                let what = format!(
                    "schema {} is {} here and {} before, or their definitions differ",
                    schema.id, schema.name, first.name
                );
                self.error(Some(place), what);
            }
            Some(_) => {}
            None => {
                self.schemas.insert(schema.id, schema);
            }
        }
    }

    fn channel(&mut self, place: RecordLocation, channel: mcap::records::Channel) {
        if channel.schema_id != 0 && !self.schemas.contains_key(&channel.schema_id) {
            let what = format!(
                "channel {} ({}) has schema {}, which is not defined before it",
                channel.id, channel.topic, channel.schema_id
            );
            self.error(Some(place), what);
        }
        match self.channels.get(&channel.id) {
            Some(first) if first.channel != channel => {
                let what = format!(
                    "channel {} is {} here and {} before, or their fields differ",
                    channel.id, channel.topic, first.channel.topic
                );
                self.error(Some(place), what);
            }
            Some(_) => {}
            None => {
                self.channels.insert(channel.id, Tally::new(channel));
            }
        }
    }

    fn message(&mut self, place: RecordLocation, header: &mcap::records::MessageHeader) {
        if self.section != Section::Data {
            self.error(Some(place), "a message after the end of the data");
        }
        self.messages += 1;
        let log_ns = header.log_time;
        if self.messages > 1 && log_ns < self.last_log_ns {
            self.out_of_order += 1;
        }
        self.last_log_ns = log_ns;
        let (start_ns, end_ns) = self.span_ns.unwrap_or((log_ns, log_ns));
        self.span_ns = Some((start_ns.min(log_ns), end_ns.max(log_ns)));
        match (&mut self.chunk, place.in_chunk) {
            (Some(chunk), Some(inner)) => chunk.message(header, inner),
            _ => self.outside += 1,
        }
        match self.channels.get_mut(&header.channel_id) {
            Some(tally) => tally.add(header, place),
            None => {
                let what = format!(
                    "a message of channel {}, which is not defined before it",
                    header.channel_id
                );
                self.error(Some(place), what);
            }
        }
    }

    fn finish(mut self) -> Inspection {
        self.settle_indexes();
        if self.header.is_none() {
            self.error(None, "there is no header");
        }
        if self.section != Section::Ended {
            self.complete = false;
        }
        let counted = self.counted();
        let used = self.used();
        let (statistics, wrong) = self.summary.finish(&counted, used, &self.chunks, self.complete);
        for (severity, what) in wrong {
            self.find(severity, None, what);
        }
        if self.out_of_order > 0 {
            let what =
                format!("{} messages are earlier than a message before them", self.out_of_order);
            self.note(None, what);
        }
        let channels: Vec<ChannelReport> = std::mem::take(&mut self.channels)
            .into_values()
            .map(|tally| tally.report(&self.schemas))
            .collect();
        for channel in &channels {
            if let Some((place, what)) = channel.lost_words() {
                self.note(place, what);
            }
        }
        let (profile, library) = self.header.take().unwrap_or_default();
        Inspection {
            bytes: self.file_bytes,
            profile,
            library,
            complete: self.complete,
            messages: self.messages,
            start_ns: self.span_ns.map(|span| span.0),
            end_ns: self.span_ns.map(|span| span.1),
            duration_s: self.span_ns.map(|(start, end)| (end - start) as f64 / 1e9),
            out_of_order: self.out_of_order,
            chunks: self.chunks.report(),
            messages_outside_chunks: self.outside,
            schemas: self.schemas.into_values().collect(),
            channels,
            attachment_count: self.summary.attachments(),
            attachments: self.attachments,
            metadata_count: self.summary.metadata_records(),
            metadata: self.metadata,
            statistics,
            errors: self.errors,
            notes: self.notes,
            findings: self.findings,
        }
    }

    /// Schemas and channels used by messages.
    fn used(&self) -> (u16, u32) {
        let used = || self.channels.values().filter(|tally| tally.messages() > 0);
        let schemas: BTreeSet<u16> =
            used().map(|tally| tally.channel.schema_id).filter(|id| *id != 0).collect();
        let schemas = u16::try_from(schemas.len()).unwrap_or(u16::MAX);
        (schemas, u32::try_from(used().count()).unwrap_or(u32::MAX))
    }

    fn counted(&self) -> mcap::records::Statistics {
        let (start, end) = self.span_ns.unwrap_or_default();
        let small = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        mcap::records::Statistics {
            message_count: self.messages,
            schema_count: u16::try_from(self.schemas.len()).unwrap_or(u16::MAX),
            channel_count: small(self.channels.len() as u64),
            attachment_count: small(self.summary.attachments()),
            metadata_count: small(self.summary.metadata_records()),
            chunk_count: small(self.chunks.count()),
            message_start_time: start,
            message_end_time: end,
            channel_message_counts: self
                .channels
                .iter()
                .filter(|(_, tally)| tally.messages() > 0)
                .map(|(id, tally)| (*id, tally.messages()))
                .collect(),
        }
    }
}
