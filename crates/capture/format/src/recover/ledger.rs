//! Accounting of recovered and lost records.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use mcap::records::{Statistics, op};
use serde::Serialize;

use crate::scan::{ChunkFrame, Crc, Raw, RecordLocation, ScanError, Skipped, kind_name};

/// Maximum number of problems listed. Others are only counted.
const MAX_LISTED_TROUBLES: usize = 200;

/// Records of one kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Written to the result.
    pub recovered: u64,
    /// In the corrupt file, as far as it states, and not in the result.
    pub lost: u64,
    /// Recovered from a chunk with a wrong checksum.
    pub suspect: u64,
}

/// Something that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Trouble {
    /// Its location.
    pub place: RecordLocation,
    /// The problem.
    pub what: String,
}

/// Result of a recovery.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Recovery {
    /// Messages.
    pub messages: Counts,
    /// Schemas.
    pub schemas: Counts,
    /// Channels.
    pub channels: Counts,
    /// Attachments.
    pub attachments: Counts,
    /// Metadata records.
    pub metadata: Counts,
    /// Chunks. Recovered ones were read to their end.
    pub chunks: Counts,
    /// Records of kinds that cannot be copied.
    pub others_lost: u64,
    /// Recovered messages by topic.
    pub topics: BTreeMap<String, u64>,
    /// True if more may have been lost than is counted: the file's own statistics are missing.
    pub lost_unknown: bool,
    /// True if the checksum of the data section is wrong: records outside of chunks may be altered,
    /// or a lost record is the cause.
    pub doubt: bool,
    /// Bytes skipped as unreadable.
    pub passed_over_bytes: u64,
    /// Number of problems.
    pub trouble_count: u64,
    /// The first problems, in the order of the file.
    pub troubles: Vec<Trouble>,
}

impl Recovery {
    pub(super) fn trouble(&mut self, place: RecordLocation, what: String) {
        self.trouble_count += 1;
        if self.troubles.len() < MAX_LISTED_TROUBLES {
            self.troubles.push(Trouble { place, what });
        }
    }

    /// True if the file was valid.
    pub fn is_clean(&self) -> bool {
        self.is_lossless() && self.trouble_count == 0
    }

    /// True if all records are in the result, without doubt. Indexes and checksums may have been
    /// lost, because they are recreated.
    pub fn is_lossless(&self) -> bool {
        let is_whole = |counts: Counts| counts.lost + counts.suspect == 0;
        let kinds = self.kinds();
        let in_doubt = self.lost_unknown || self.doubt || self.others_lost > 0;
        !in_doubt && kinds.iter().all(|(_, counts)| is_whole(*counts))
    }

    fn kinds(&self) -> [(&'static str, Counts); 6] {
        [
            ("messages", self.messages),
            ("schemas", self.schemas),
            ("channels", self.channels),
            ("attachments", self.attachments),
            ("metadata", self.metadata),
            ("chunks", self.chunks),
        ]
    }

    /// The same for the result's own metadata.
    pub(super) fn notes(&self) -> BTreeMap<String, String> {
        let mut notes = BTreeMap::new();
        for (kind, counts) in self.kinds() {
            notes.insert(format!("{kind}_recovered"), counts.recovered.to_string());
            notes.insert(format!("{kind}_lost"), counts.lost.to_string());
            notes.insert(format!("{kind}_suspect"), counts.suspect.to_string());
        }
        notes.insert("lost_unknown".to_owned(), self.lost_unknown.to_string());
        for (number, trouble) in self.troubles.iter().take(20).enumerate() {
            let what = format!("{}: {}", trouble.place, trouble.what);
            notes.insert(format!("trouble_{number:02}"), what);
        }
        notes
    }
}

impl fmt::Display for Recovery {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for trouble in &self.troubles {
            writeln!(out, "{}: {}", trouble.place, trouble.what)?;
        }
        if self.trouble_count > self.troubles.len() as u64 {
            writeln!(out, "… and {} more", self.trouble_count - self.troubles.len() as u64)?;
        }
        writeln!(out, "{:<12} {:>10} {:>10} {:>10}", "", "recovered", "lost", "suspect")?;
        for (kind, counts) in self.kinds() {
            writeln!(
                out,
                "{kind:<12} {:>10} {:>10} {:>10}",
                counts.recovered, counts.lost, counts.suspect
            )?;
        }
        if self.others_lost > 0 {
            writeln!(out, "other records left out: {}", self.others_lost)?;
        }
        if self.doubt {
            writeln!(out, "the data section has another checksum than was saved")?;
        }
        if self.passed_over_bytes > 0 {
            writeln!(out, "bytes without anything readable: {}", self.passed_over_bytes)?;
        }
        if self.lost_unknown {
            writeln!(
                out,
                "the file does not say how much it had: more may be lost than is counted"
            )?;
        }
        Ok(())
    }
}

/// The recovery so far, and the state of its counts during the scan.
#[derive(Debug, Clone, Default)]
pub(super) struct Ledger {
    pub(super) found: Recovery,
    seen_schemas: BTreeSet<u16>,
    chunk: Option<OpenChunk>,
    data_ended: bool,
    /// Messages may be lost without any index that counts them.
    uncounted: bool,
}

/// The last chunk, while its message indexes follow.
#[derive(Debug, Clone, Copy, Default)]
struct OpenChunk {
    recovered: u64,
    /// Messages of channels that are not defined in the file.
    orphans: u64,
    indexed: u64,
    has_index: bool,
    broken: bool,
}

impl Ledger {
    /// True if nothing that a file is kept for was found.
    pub(super) fn is_empty(&self) -> bool {
        let kinds = [self.found.messages, self.found.attachments, self.found.metadata];
        kinds.iter().all(|counts| counts.recovered == 0)
    }

    pub(super) fn is_past_data(&self) -> bool {
        self.data_ended
    }

    pub(super) fn has_schema(&self, id: u16) -> bool {
        id == 0 || self.seen_schemas.contains(&id)
    }

    pub(super) fn schema(&mut self, id: u16) {
        if self.seen_schemas.insert(id) {
            self.found.schemas.recovered += 1;
        }
    }

    /// Chunks cannot follow the end of the data: that record was not the real end.
    pub(super) fn chunk_begins(&mut self, frame: &ChunkFrame) {
        self.settle_chunk();
        if std::mem::take(&mut self.data_ended) {
            let what = "chunk: behind what looked like the end of the data".to_owned();
            self.found.trouble(RecordLocation { offset: frame.offset, in_chunk: None }, what);
        }
        self.chunk = Some(OpenChunk::default());
    }

    pub(super) fn chunk_ends(&mut self, frame: &ChunkFrame, crc: Crc) {
        self.found.chunks.recovered += 1;
        if !crc.is_wrong() {
            return;
        }
        let suspect = self.chunk.map_or(0, |chunk| chunk.recovered);
        self.found.chunks.suspect += 1;
        self.found.messages.suspect += suspect;
        let (start, end) = (frame.header.message_start_time, frame.header.message_end_time);
        let what = format!(
            "chunk: its checksum is wrong, and its {suspect} messages, log time {start} to {end} \
             ns, are suspect"
        );
        let place = RecordLocation { offset: frame.offset, in_chunk: None };
        self.found.trouble(place, what);
    }

    /// Before a record is processed.
    pub(super) fn before(&mut self, raw: &Raw<'_>) {
        let is_of_chunk = raw.place.in_chunk.is_some()
            || matches!(raw.opcode, op::MESSAGE_INDEX | op::MESSAGE | op::SCHEMA | op::CHANNEL);
        if !is_of_chunk {
            self.settle_chunk();
        }
    }

    /// Counts the unrecovered messages of a corrupt chunk.
    fn settle_chunk(&mut self) {
        let Some(chunk) = self.chunk.take() else {
            return;
        };
        if chunk.has_index {
            self.found.messages.lost +=
                chunk.indexed.saturating_sub(chunk.recovered + chunk.orphans);
        } else if chunk.broken {
            self.uncounted = true;
        }
    }

    pub(super) fn broken(&mut self, error: &ScanError) {
        let place = error.place();
        if let (Some(chunk), Some(_)) = (&mut self.chunk, place.in_chunk) {
            chunk.broken = true;
            self.found.chunks.lost += 1;
        } else if !self.data_ended {
            self.settle_chunk();
            self.uncounted = true;
        }
        let words = error.to_string();
        let begin = format!("{place}: ");
        let what = words.strip_prefix(&begin).unwrap_or(&words).to_owned();
        self.found.trouble(place, what);
    }

    pub(super) fn skipped(&mut self, skipped: Skipped) {
        self.found.passed_over_bytes += skipped.to - skipped.from;
    }

    pub(super) fn too_long(&mut self, place: RecordLocation, opcode: u8, bytes: u64) {
        let what = format!("{} of {bytes} bytes is too long to be copied", kind_name(opcode));
        match self.kind(opcode) {
            Some(counts) => counts.lost += 1,
            None => self.found.others_lost += 1,
        }
        self.found.trouble(place, what);
    }

    pub(super) fn unreadable(&mut self, opcode: u8, error: &ScanError) {
        if matches!(opcode, op::MESSAGE_INDEX | op::CHUNK_INDEX | op::STATISTICS) {
            // Recreated.
        } else if let Some(counts) = self.kind(opcode) {
            counts.lost += 1;
        }
        let words = error.to_string();
        let begin = format!("{}: ", error.place());
        let what = words.strip_prefix(&begin).unwrap_or(&words).to_owned();
        self.found.trouble(error.place(), what);
    }

    fn kind(&mut self, opcode: u8) -> Option<&mut Counts> {
        Some(match opcode {
            op::MESSAGE => &mut self.found.messages,
            op::SCHEMA => &mut self.found.schemas,
            op::CHANNEL => &mut self.found.channels,
            op::ATTACHMENT => &mut self.found.attachments,
            op::METADATA => &mut self.found.metadata,
            _ => return None,
        })
    }

    pub(super) fn other_lost(&mut self, place: RecordLocation, what: String) {
        self.found.others_lost += 1;
        self.found.trouble(place, what);
    }

    pub(super) fn orphan(&mut self, place: RecordLocation, channel: u16) {
        let what = format!("message of channel {channel}, which is nowhere in the file");
        // The index after its chunk counts it too: it must be counted as lost once.
        if let Some(chunk) = &mut self.chunk {
            chunk.orphans += 1;
        }
        self.found.messages.lost += 1;
        self.found.trouble(place, what);
    }

    pub(super) fn message(&mut self, topic: &str) {
        self.found.messages.recovered += 1;
        if let Some(chunk) = &mut self.chunk {
            chunk.recovered += 1;
        }
        match self.found.topics.get_mut(topic) {
            Some(count) => *count += 1,
            None => {
                self.found.topics.insert(topic.to_owned(), 1);
            }
        }
    }

    pub(super) fn message_index(&mut self, entries: u64) {
        if let Some(chunk) = &mut self.chunk {
            chunk.indexed += entries;
            chunk.has_index = true;
        }
    }

    pub(super) fn data_ends(&mut self, crc: Option<Crc>) {
        self.settle_chunk();
        self.data_ended = true;
        if let Some(crc) = crc.filter(Crc::is_wrong) {
            self.found.doubt = true;
            let Crc { saved, found } = crc;
            let what = format!("data section: checksum {found:08x}, stored was {saved:08x}");
            let place = RecordLocation { offset: 0, in_chunk: None };
            self.found.trouble(place, what);
        }
    }

    /// A record that is not allowed in the summary.
    pub(super) fn misplaced(&mut self, place: RecordLocation, opcode: u8) {
        let what = format!("{} behind the end of the data", kind_name(opcode));
        self.found.trouble(place, what);
    }

    pub(super) fn footer(&mut self, place: RecordLocation, crc: Option<Crc>) {
        if let Some(Crc { saved, found }) = crc.filter(Crc::is_wrong) {
            let what =
                format!("summary: checksum {found:08x}, stored was {saved:08x}. It is recreated");
            self.found.trouble(place, what);
        }
    }

    /// Completes the counts. The file's own statistics are better than the counts of the scan.
    pub(super) fn settle(mut self, statistics: Option<&Statistics>) -> Recovery {
        self.settle_chunk();
        if let Some(stated) = statistics {
            if let Some(more) = self.found.messages.recovered.checked_sub(stated.message_count + 1)
            {
                let what = format!("{} messages more than the statistics state", more + 1);
                let place = RecordLocation { offset: 0, in_chunk: None };
                self.found.trouble(place, what);
            }
            let exact = |counts: &mut Counts, stated: u64| {
                counts.lost = stated.saturating_sub(counts.recovered);
            };
            exact(&mut self.found.messages, stated.message_count);
            exact(&mut self.found.attachments, stated.attachment_count.into());
            exact(&mut self.found.metadata, stated.metadata_count.into());
            exact(&mut self.found.chunks, stated.chunk_count.into());
            let missing = |counts: &mut Counts, stated: u64| {
                counts.lost = counts.lost.max(stated.saturating_sub(counts.recovered));
            };
            missing(&mut self.found.schemas, stated.schema_count.into());
            missing(&mut self.found.channels, stated.channel_count.into());
        }
        // A changed opcode can hide a whole chunk. Only the checksum of the data section shows it.
        let uncounted = self.uncounted || self.found.doubt || !self.data_ended;
        self.found.lost_unknown = statistics.is_none() && uncounted;
        self.found
    }
}
