//! Inspection and validation of MCAP files.
//!
//! One pass over the whole file in bounded memory. The checksums of chunks, of the data and of the
//! summary cover every byte of our captures. Whether the indexes and the statistics of a file agree
//! with its contents is checked by `mcap doctor`.

mod channel;
mod finding;
mod records;
mod report;

use std::collections::BTreeMap;
use std::io::{Read, Seek};

use mcap::records::{Record, op};

use crate::definitions::CHANNELS;
use crate::scan::{ChunkFrame, Crc, Event, Raw, RecordLocation, Scan, ScanError};
use channel::Tally;
pub use channel::{ChannelReport, Sequence};
pub use finding::{Finding, Severity};
pub use records::{AttachmentReport, CompressionReport, MetadataReport, SchemaReport};
pub use report::Inspection;

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
    let found = Inspection { bytes: scan.file_bytes(), complete: true, ..Inspection::default() };
    let mut inspector = Inspector { found, ..Inspector::default() };
    loop {
        match scan.next_event() {
            Ok(Some(event)) => inspector.take(event),
            Ok(None) => break,
            Err(error @ ScanError::Io { .. }) => return Err(error),
            Err(error) => {
                inspector.found.complete = false;
                inspector.error(Some(error.place()), error_words(&error));
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
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Section {
    #[default]
    Data,
    Summary,
    Ended,
}

#[derive(Default)]
struct Inspector {
    found: Inspection,
    section: Section,
    has_header: bool,
    records: u64,
    schemas: BTreeMap<u16, SchemaReport>,
    channels: BTreeMap<u16, Tally>,
    last_log_ns: u64,
}

impl Inspector {
    fn find(&mut self, severity: Severity, place: Option<RecordLocation>, what: String) {
        match severity {
            Severity::Error => self.found.errors += 1,
            Severity::Note => self.found.notes += 1,
        }
        if self.found.findings.len() < MAX_LISTED_FINDINGS {
            self.found.findings.push(Finding { severity, place, what });
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
            Event::ChunkBegins(_) => self.records += 1,
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
        let (header, chunks) = (&frame.header, &mut self.found.chunks);
        let place = match chunks.binary_search_by(|of| of.compression.cmp(&header.compression)) {
            Ok(place) => place,
            Err(place) => {
                let compression = header.compression.clone();
                chunks.insert(
                    place,
                    CompressionReport { compression, ..CompressionReport::default() },
                );
                place
            }
        };
        let report = &mut chunks[place];
        report.chunks += 1;
        report.compressed_bytes += header.compressed_size;
        report.uncompressed_bytes += header.uncompressed_size;
        report.unchecked += u64::from(crc.saved == 0);
    }

    fn record(&mut self, raw: &Raw<'_>) {
        self.records += 1;
        if self.section == Section::Data && self.records == 1 && raw.opcode != op::HEADER {
            self.error(Some(raw.place), "the first record is not a header");
        }
        let record = match raw.parse() {
            Ok(record) => record,
            Err(error) => return self.error(Some(raw.place), error_words(&error)),
        };
        match record {
            Record::Message { header, .. } => self.message(raw.place, &header),
            Record::Header(header) => {
                self.has_header = true;
                (self.found.profile, self.found.library) = (header.profile, header.library);
            }
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
            Record::Attachment { header, data, .. } => {
                self.found.attachment_count += 1;
                if self.found.attachments.len() < MAX_LISTED_RECORDS {
                    self.found.attachments.push(AttachmentReport {
                        name: header.name,
                        media_type: header.media_type,
                        bytes: data.len() as u64,
                        log_ns: header.log_time,
                        create_ns: header.create_time,
                    });
                }
            }
            Record::Metadata(metadata) => {
                self.found.metadata_count += 1;
                // They tell again what the report says of the channels.
                let is_listed = metadata.name != CHANNELS;
                if is_listed && self.found.metadata.len() < MAX_LISTED_RECORDS {
                    let (name, entries) = (metadata.name, metadata.metadata);
                    self.found.metadata.push(MetadataReport { name, entries });
                }
            }
            Record::DataEnd(_) => {
                self.check_crc(raw, "data section");
                self.section = Section::Summary;
            }
            Record::Footer(_) => {
                self.check_crc(raw, "summary");
                if self.section == Section::Data {
                    self.error(Some(raw.place), "there is no end of data before the footer");
                }
                self.section = Section::Ended;
            }
            Record::Unknown { opcode, .. } => {
                let what =
                    format!("a record of opcode {opcode:#04x}, which is not defined by the format");
                self.note(Some(raw.place), what);
            }
            Record::MessageIndex(_)
            | Record::ChunkIndex(_)
            | Record::AttachmentIndex(_)
            | Record::MetadataIndex(_)
            | Record::Statistics(_)
            | Record::SummaryOffset(_) => {}
            other => {
                let what =
                    format!("a record of opcode {:#04x} is not allowed here", other.opcode());
                self.error(Some(raw.place), what);
            }
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
        let (found, log_ns) = (&mut self.found, header.log_time);
        found.messages += 1;
        found.out_of_order += u64::from(log_ns < self.last_log_ns);
        self.last_log_ns = log_ns;
        found.start_ns = Some(found.start_ns.map_or(log_ns, |start_ns| start_ns.min(log_ns)));
        found.end_ns = found.end_ns.max(Some(log_ns));
        found.messages_outside_chunks += u64::from(place.in_chunk.is_none());
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
        if !self.has_header {
            self.error(None, "there is no header");
        }
        self.found.complete &= self.section == Section::Ended;
        if self.found.out_of_order > 0 {
            let count = self.found.out_of_order;
            self.note(None, format!("{count} messages are earlier than a message before them"));
        }
        let tallies = std::mem::take(&mut self.channels).into_values();
        let channels: Vec<ChannelReport> =
            tallies.map(|tally| tally.report(&self.schemas)).collect();
        for channel in &channels {
            if let Some((place, what)) = channel.lost_words() {
                self.note(place, what);
            }
        }
        let span_ns = self.found.start_ns.zip(self.found.end_ns);
        Inspection {
            duration_s: span_ns.map(|(start, end)| (end - start) as f64 / 1e9),
            schemas: self.schemas.into_values().collect(),
            channels,
            ..self.found
        }
    }
}
