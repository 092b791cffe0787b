//! The summary section of a file, compared with its data section.

use std::collections::{BTreeMap, HashMap};

use mcap::records::{AttachmentHeader, Footer, Record, Statistics, op};
use serde::Serialize;

use super::chunks::Chunks;
use super::finding::Severity;

/// Comparison of the statistics in a file with the counts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "state")]
pub enum StatisticsCheck {
    /// The file has no statistics.
    Missing,
    /// They equal the counts.
    Agree,
    /// They differ.
    Differ {
        /// Each difference: name, stated and actual count.
        differences: Vec<String>,
    },
}

/// An attachment or a metadata record, for comparison with its index.
struct Entry {
    bytes: u64,
    name: String,
    data_bytes: u64,
    times: (u64, u64),
    indexed: bool,
}

/// The summary read so far, with the data to compare it with.
#[derive(Default)]
pub(super) struct Summary {
    starts_at: Option<u64>,
    attachments: HashMap<u64, Entry>,
    metadata: HashMap<u64, Entry>,
    statistics: Option<Statistics>,
    chunk_indexes: u64,
    attachment_indexes: u64,
    metadata_indexes: u64,
    /// Offset and length of each group of records of one kind.
    groups: BTreeMap<u8, (u64, u64)>,
    summary_offsets: Vec<mcap::records::SummaryOffset>,
}

impl Summary {
    pub(super) fn attachments(&self) -> u64 {
        self.attachments.len() as u64
    }

    pub(super) fn metadata_records(&self) -> u64 {
        self.metadata.len() as u64
    }

    pub(super) fn attachment(
        &mut self,
        offset: u64,
        bytes: u64,
        header: &AttachmentHeader,
        data: u64,
    ) {
        let entry = Entry {
            bytes,
            name: header.name.clone(),
            data_bytes: data,
            times: (header.log_time, header.create_time),
            indexed: false,
        };
        self.attachments.insert(offset, entry);
    }

    pub(super) fn metadata(&mut self, offset: u64, bytes: u64, name: &str) {
        let entry =
            Entry { bytes, name: name.to_owned(), data_bytes: 0, times: (0, 0), indexed: false };
        self.metadata.insert(offset, entry);
    }

    /// The data section ends. The summary begins at `offset`.
    pub(super) fn begins(&mut self, offset: u64) {
        self.starts_at = Some(offset);
    }

    /// Records the group of a record in the summary, for the summary offsets.
    pub(super) fn group(&mut self, opcode: u8, offset: u64, bytes: u64) {
        if matches!(opcode, op::DATA_END | op::FOOTER) {
            return;
        }
        let group = self.groups.entry(opcode).or_insert((offset, 0));
        if group.0 + group.1 == offset {
            group.1 += bytes;
        }
    }

    /// Checks a record of the summary. Returns the error.
    pub(super) fn take(
        &mut self,
        offset: u64,
        record: Record<'_>,
        chunks: &mut Chunks,
    ) -> Option<String> {
        match record {
            Record::Statistics(statistics) => {
                self.statistics = Some(statistics);
                None
            }
            Record::ChunkIndex(index) => {
                self.chunk_indexes += 1;
                chunks.chunk_index(&index)
            }
            Record::AttachmentIndex(index) => {
                self.attachment_indexes += 1;
                let at = index.offset;
                let Some(entry) = self.attachments.get_mut(&at) else {
                    return Some(format!(
                        "attachment index: there is no valid attachment at byte {at}"
                    ));
                };
                entry.indexed = true;
                let agrees = entry.bytes == index.length
                    && entry.name == index.name
                    && entry.data_bytes == index.data_size
                    && entry.times == (index.log_time, index.create_time);
                (!agrees).then(|| {
                    format!("attachment index: {:?} at byte {at} has other fields", entry.name)
                })
            }
            Record::MetadataIndex(index) => {
                self.metadata_indexes += 1;
                let at = index.offset;
                let Some(entry) = self.metadata.get_mut(&at) else {
                    return Some(format!(
                        "metadata index: there is no valid metadata at byte {at}"
                    ));
                };
                entry.indexed = true;
                let agrees = entry.bytes == index.length && entry.name == index.name;
                (!agrees).then(|| {
                    format!("metadata index: {:?} at byte {at} has other fields", entry.name)
                })
            }
            Record::SummaryOffset(summary_offset) => {
                self.summary_offsets.push(summary_offset);
                None
            }
            other => {
                Some(format!("opcode {:#04x} is not allowed at byte {offset}", other.opcode()))
            }
        }
    }

    /// Errors of the footer at `offset`.
    pub(super) fn footer(&mut self, offset: u64, footer: Footer) -> Vec<String> {
        let mut wrong = Vec::new();
        let start = self.starts_at.filter(|start| *start != offset).unwrap_or(0);
        let offsets = self.groups.get(&op::SUMMARY_OFFSET).map_or(0, |(start, _)| *start);
        // If there are only summary offsets, there is no summary start.
        let start = if start == offsets { 0 } else { start };
        if self.starts_at.is_none() {
            wrong.push("there is no end of data before the footer".to_owned());
        } else if footer.summary_start != start
            && footer.summary_start != self.starts_at.unwrap_or(0)
        {
            wrong.push(format!(
                "footer: the summary begins at byte {start}, not {}",
                footer.summary_start
            ));
        }
        if footer.summary_offset_start != offsets {
            let stated = footer.summary_offset_start;
            wrong
                .push(format!("footer: the summary offsets begin at byte {offsets}, not {stated}"));
        }
        for stated in &self.summary_offsets {
            let found = self.groups.get(&stated.group_opcode).copied().unwrap_or_default();
            // Python's writer lists groups without records, too, at any byte.
            let is_empty = found.1 == 0 && stated.group_length == 0;
            if !is_empty && found != (stated.group_start, stated.group_length) {
                wrong.push(format!(
                    "summary offset: {} records are {} bytes from byte {}, not {} from {}",
                    crate::scan::kind_name(stated.group_opcode),
                    found.1,
                    found.0,
                    stated.group_length,
                    stated.group_start
                ));
            }
        }
        wrong
    }

    /// Final checks of the summary against the file.
    pub(super) fn finish(
        &self,
        counted: &Statistics,
        used: (u16, u32),
        chunks: &Chunks,
        complete: bool,
    ) -> (StatisticsCheck, Vec<(Severity, String)>) {
        let mut wrong = Vec::new();
        let check = match &self.statistics {
            None => StatisticsCheck::Missing,
            Some(stated) => {
                let mut counted = counted.clone();
                // libmcap omits schemas and channels without messages.
                if (stated.schema_count, stated.channel_count) == used
                    && used.1 < counted.channel_count
                {
                    let what = "the statistics omit schemas and channels without messages";
                    wrong.push((Severity::Note, what.to_owned()));
                    (counted.schema_count, counted.channel_count) = used;
                }
                let differences = differences(stated, &counted);
                if differences.is_empty() {
                    StatisticsCheck::Agree
                } else {
                    wrong
                        .push((Severity::Error, format!("statistics: {}", differences.join(", "))));
                    StatisticsCheck::Differ { differences }
                }
            }
        };
        if !complete {
            return (check, wrong);
        }
        let unindexed = |entries: &HashMap<u64, Entry>| {
            entries.values().filter(|entry| !entry.indexed).count() as u64
        };
        for (kind, indexes, unindexed) in [
            ("chunks", self.chunk_indexes, chunks.unindexed()),
            ("attachments", self.attachment_indexes, unindexed(&self.attachments)),
            ("metadata records", self.metadata_indexes, unindexed(&self.metadata)),
        ] {
            if unindexed > 0 {
                let severity = if indexes > 0 { Severity::Error } else { Severity::Note };
                wrong.push((severity, format!("{unindexed} {kind} are not indexed")));
            }
        }
        if self.statistics.is_none() {
            wrong.push((Severity::Note, "there are no statistics".to_owned()));
        }
        if let Some(place) = chunks.without_index() {
            let what = format!("{place}: a chunk without message indexes, while others have them");
            wrong.push((Severity::Error, what));
        }
        (check, wrong)
    }
}

/// The counts that differ, as text.
fn differences(stated: &Statistics, counted: &Statistics) -> Vec<String> {
    let counts = |of: &Statistics| -> [(&str, u64); 8] {
        // Without messages the times are meaningless.
        let (first, last) = match of.message_count {
            0 => (0, 0),
            _ => (of.message_start_time, of.message_end_time),
        };
        [
            ("messages", of.message_count),
            ("schemas", of.schema_count.into()),
            ("channels", of.channel_count.into()),
            ("attachments", of.attachment_count.into()),
            ("metadata records", of.metadata_count.into()),
            ("chunks", of.chunk_count.into()),
            ("first log time", first),
            ("last log time", last),
        ]
    };
    let both = counts(stated).into_iter().zip(counts(counted));
    let mut differences: Vec<String> = both
        .filter(|(stated, counted)| stated != counted)
        .map(|((what, stated), (_, counted))| format!("{what}: {stated} stated, {counted} found"))
        .collect();
    let channels =
        stated.channel_message_counts.keys().chain(counted.channel_message_counts.keys());
    let mut channels: Vec<u16> = channels.copied().collect();
    channels.sort_unstable();
    channels.dedup();
    for channel in channels {
        let of = |statistics: &Statistics| {
            let count = statistics.channel_message_counts.get(&channel);
            count.copied().unwrap_or(0)
        };
        let (stated, counted) = (of(stated), of(counted));
        if stated != counted {
            differences
                .push(format!("channel {channel}: {stated} messages stated, {counted} found"));
        }
    }
    differences
}
