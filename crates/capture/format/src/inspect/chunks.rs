//! Chunks and their message indexes.

use std::collections::{BTreeMap, HashMap};

use mcap::records::{ChunkIndex, MessageHeader, MessageIndex};
use serde::Serialize;

use crate::scan::{ChunkFrame, RecordLocation};

/// The chunks of one compression.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CompressionReport {
    /// `zstd`, `lz4`, or empty.
    pub compression: String,
    /// Number of chunks.
    pub chunks: u64,
    /// Size of their records in the file, bytes.
    pub compressed_bytes: u64,
    /// Size of their records decompressed, bytes.
    pub uncompressed_bytes: u64,
    /// Chunks without a checksum.
    pub unchecked: u64,
}

/// Messages of a channel in a chunk: their number, and a sum over the time and position of each
/// that does not depend on their order. Lists with equal sums are considered equal.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Listed {
    count: u64,
    sum: u64,
}

impl Listed {
    fn add(&mut self, log_ns: u64, offset: u64) {
        // SplitMix64's finaliser: similar pairs give dissimilar sums.
        let mut mixed = log_ns.rotate_left(32) ^ offset.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        self.count += 1;
        self.sum = self.sum.wrapping_add(mixed ^ (mixed >> 31));
    }
}

/// A chunk during the scan.
pub(super) struct Open {
    offset: u64,
    end: u64,
    span_ns: Option<(u64, u64)>,
    listed: BTreeMap<u16, Listed>,
}

impl Open {
    pub(super) fn new(frame: &ChunkFrame) -> Self {
        Self {
            offset: frame.offset,
            end: frame.offset.saturating_add(frame.bytes),
            span_ns: None,
            listed: BTreeMap::new(),
        }
    }

    pub(super) fn message(&mut self, header: &MessageHeader, offset: u64) {
        let log_ns = header.log_time;
        let (start, end) = self.span_ns.unwrap_or((log_ns, log_ns));
        self.span_ns = Some((start.min(log_ns), end.max(log_ns)));
        let listed = self.listed.entry(header.channel_id).or_default();
        listed.add(log_ns, offset);
    }

    /// Error of the time range in the chunk's head.
    pub(super) fn wrong_span(&self, frame: &ChunkFrame) -> Option<String> {
        let header = &frame.header;
        let stated = (header.message_start_time, header.message_end_time);
        let found = self.span_ns.unwrap_or_default();
        (stated != found).then(|| {
            format!(
                "chunk: its messages are of {} to {} ns, its head says {} to {} ns",
                found.0, found.1, stated.0, stated.1
            )
        })
    }
}

/// Data of a chunk to compare with the chunk index.
struct Known {
    bytes: u64,
    span_ns: (u64, u64),
    sizes: (u64, u64),
    compression: String,
    /// Offsets of its message indexes, by channel.
    indexes: BTreeMap<u16, u64>,
    indexes_end: u64,
    end: u64,
    indexed: bool,
}

#[derive(Default)]
pub(super) struct Chunks {
    known: HashMap<u64, Known>,
    by_compression: BTreeMap<String, CompressionReport>,
    /// The last chunk, while its message indexes follow.
    last: Option<Open>,
    indexes_seen: bool,
    missing_index: Option<RecordLocation>,
}

impl Chunks {
    pub(super) fn count(&self) -> u64 {
        self.by_compression.values().map(|report| report.chunks).sum()
    }

    pub(super) fn report(&self) -> Vec<CompressionReport> {
        self.by_compression.values().cloned().collect()
    }

    pub(super) fn add(&mut self, frame: &ChunkFrame, open: Open, unchecked: bool) {
        let header = &frame.header;
        let report = self.by_compression.entry(header.compression.clone()).or_insert_with(|| {
            CompressionReport {
                compression: header.compression.clone(),
                chunks: 0,
                compressed_bytes: 0,
                uncompressed_bytes: 0,
                unchecked: 0,
            }
        });
        report.chunks += 1;
        report.compressed_bytes += header.compressed_size;
        report.uncompressed_bytes += header.uncompressed_size;
        report.unchecked += u64::from(unchecked);
        self.known.insert(
            frame.offset,
            Known {
                bytes: frame.bytes,
                span_ns: (header.message_start_time, header.message_end_time),
                sizes: (header.compressed_size, header.uncompressed_size),
                compression: header.compression.clone(),
                indexes: BTreeMap::new(),
                indexes_end: open.end,
                end: open.end,
                indexed: false,
            },
        );
        self.last = Some(open);
    }

    /// Compares a message index with the chunk before it. Returns the error.
    pub(super) fn message_index(
        &mut self,
        place: RecordLocation,
        bytes: u64,
        index: &MessageIndex,
    ) -> Option<String> {
        self.indexes_seen = true;
        let channel = index.channel_id;
        let Some(open) = &mut self.last else {
            return Some(format!("message index of channel {channel} behind no chunk"));
        };
        if let Some(known) = self.known.get_mut(&open.offset) {
            known.indexes.insert(channel, place.offset);
            known.indexes_end = place.offset + bytes;
        }
        let mut stated = Listed::default();
        for entry in &index.records {
            stated.add(entry.log_time, entry.offset);
        }
        let found = open.listed.remove(&channel).unwrap_or_default();
        (stated != found).then(|| {
            format!(
                "message index of channel {channel}: {} entries do not agree with its {} messages in the chunk at byte {}",
                stated.count, found.count, open.offset
            )
        })
    }

    /// Ends the message indexes of the last chunk. Returns missing ones.
    pub(super) fn settle(&mut self) -> Vec<(RecordLocation, String)> {
        let Some(open) = self.last.take() else {
            return Vec::new();
        };
        let place = RecordLocation { offset: open.offset, in_chunk: None };
        let known = self.known.get(&open.offset);
        if known.is_some_and(|known| known.indexes.is_empty()) {
            if !open.listed.is_empty() {
                self.missing_index.get_or_insert(place);
            }
            return Vec::new();
        }
        let words = |(channel, listed): (&u16, &Listed)| {
            let what = format!(
                "chunk: no message index for {} messages of channel {channel}",
                listed.count
            );
            (place, what)
        };
        open.listed.iter().map(words).collect()
    }

    /// A chunk without any message index in a file that has some.
    pub(super) fn without_index(&self) -> Option<RecordLocation> {
        self.missing_index.filter(|_| self.indexes_seen)
    }

    /// Compares a chunk index with the chunk. Returns the error.
    pub(super) fn chunk_index(&mut self, index: &ChunkIndex) -> Option<String> {
        let offset = index.chunk_start_offset;
        let Some(known) = self.known.get_mut(&offset) else {
            return Some(format!("chunk index: there is no valid chunk at byte {offset}"));
        };
        known.indexed = true;
        let span = (index.message_start_time, index.message_end_time);
        let sizes = (index.compressed_size, index.uncompressed_size);
        let length = known.indexes_end - known.end;
        let wrong = if index.chunk_length != known.bytes {
            "length"
        } else if span != known.span_ns {
            "times"
        } else if sizes != known.sizes || index.compression != known.compression {
            "sizes or compression"
        } else if index.message_index_offsets != known.indexes
            || index.message_index_length != length
        {
            "message indexes"
        } else {
            return None;
        };
        Some(format!("chunk index: the {wrong} of the chunk at byte {offset} differ"))
    }

    /// Chunks without a chunk index.
    pub(super) fn unindexed(&self) -> u64 {
        self.known.values().filter(|known| !known.indexed).count() as u64
    }
}
