//! Writes captures.

mod error;
mod output;
mod settings;

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::McapError;
use mcap::records::MessageHeader;
use mcap::write::NoSeek;

use crate::definitions::{self, ENCODING, SchemaKey};
use crate::{Attachments, Message, MessageKind};
pub use error::WriteError;
pub(crate) use error::reason;
use output::Output;
pub use settings::{CaptureSettings, Preset};

/// Maximum number of channels in a file: their ids are u16, and 0 is unused.
pub const MAX_CHANNELS: usize = 65_535;

/// Log time after which all channels are told again, ns.
const TELL_NS: u64 = 60_000_000_000;

/// Log time and publish time of a message, Unix ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Times {
    /// When the recorder received it. Must not decrease.
    pub log_ns: u64,
    /// When it was sent.
    pub publish_ns: u64,
}

/// Writes a capture, chunk by chunk: a chunk is written to the file as a whole when it spans
/// [`CaptureSettings::chunk_ns`], when [`Writer::flush`] is called, and at the end. Data written to
/// the file remains readable whatever happens later, and only that counts as written: every message
/// passed to [`Writer::write`] is in [`Writer::written`] or in [`Writer::unwritten`].
///
/// Dropping it without [`Writer::finish`] leaves a file that may be truncated.
pub struct Writer<W: Write> {
    mcap: mcap::Writer<NoSeek<Output<W>>>,
    settings: CaptureSettings,
    schemas: HashMap<MessageKind, SchemaKey>,
    channels: HashMap<(MessageKind, u32), Vec<Channel>>,
    opened: usize,
    /// Number of channels when [`crate::definitions`] told them last. Their ids are 1 and so on.
    told: usize,
    /// Log time when all were told.
    told_ns: u64,
    sequences: Sequences,
    chunk_from_ns: Option<u64>,
    log_ns: u64,
    /// Statistics of the file.
    messages: u64,
    encoded: u64,
    bytes: Arc<AtomicU64>,
    /// Entries of the index: one for each channel in each chunk.
    index_entries: u64,
    open: OpenChunk,
    /// Refused messages by topic.
    refused: BTreeMap<String, u64>,
    failed: bool,
    scratch: Vec<u8>,
}

/// Messages accepted and not yet in the file.
#[derive(Debug, Default)]
struct OpenChunk {
    messages: u64,
    encoded: u64,
    by_channel: HashMap<u16, u64>,
}

impl<W: Write> fmt::Debug for Writer<W> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Writer")
            .field("settings", &self.settings)
            .field("messages", &self.messages)
            .field("bytes", &self.bytes)
            .field("failed", &self.failed)
            .finish_non_exhaustive()
    }
}

struct Channel {
    fleet: Arc<str>,
    id: u16,
    sequence: u32,
}

impl OpenChunk {
    /// Number of messages of the channel.
    fn of(&self, channel: &Channel) -> u64 {
        self.by_channel.get(&channel.id).copied().unwrap_or(0)
    }
}

/// The next sequence number of each channel, by topic, to continue in the next file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Sequences(BTreeMap<String, u32>);

/// Statistics of a file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Written {
    /// Messages.
    pub messages: u64,
    /// Messages by topic.
    pub by_topic: BTreeMap<String, u64>,
    /// Bytes of the file.
    pub bytes: u64,
    /// Bytes of the messages before compression.
    pub encoded_bytes: u64,
}

impl<W: Write> Writer<W> {
    /// Begins a capture: header, metadata and attachments are written to `out` at once.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn new(
        out: W,
        settings: CaptureSettings,
        attachments: &Attachments,
    ) -> Result<Self, WriteError> {
        Self::resume(out, settings, attachments, Sequences::default())
    }

    /// Begins the next file of a capture, whose channels continue from the last file.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn resume(
        out: W,
        settings: CaptureSettings,
        attachments: &Attachments,
        sequences: Sequences,
    ) -> Result<Self, WriteError> {
        let bytes = Arc::default();
        let output = Output::new(out, Arc::clone(&bytes));
        let mut mcap = settings.options().create(NoSeek::new(output)).map_err(failed)?;
        for record in attachments.metadata_records() {
            mcap.write_metadata(&record).map_err(failed)?;
        }
        for file in &attachments.files {
            mcap.attach(&file.record(attachments.created_unix_ns)).map_err(failed)?;
        }
        mcap.flush().map_err(failed)?;
        Ok(Self {
            mcap,
            settings,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            opened: 0,
            told: 0,
            told_ns: 0,
            sequences,
            chunk_from_ns: None,
            log_ns: 0,
            messages: 0,
            encoded: 0,
            bytes,
            index_entries: 0,
            open: OpenChunk::default(),
            refused: BTreeMap::new(),
            failed: false,
            scratch: Vec::new(),
        })
    }

    /// Appends a message of `fleet`. Its log time is raised to that of the previous message if it
    /// is lower: a capture is in order.
    ///
    /// # Errors
    /// [`WriteError`]. After a failure to write every further call fails.
    pub fn write(
        &mut self,
        fleet: &str,
        times: Times,
        message: &Message,
    ) -> Result<(), WriteError> {
        let Some(kind) = message.kind() else {
            return Err(WriteError::NotOurs);
        };
        let taken = match self.check() {
            Ok(()) => self.append(fleet, times, kind, message),
            stopped => stopped,
        };
        if taken.is_err() {
            let topic = kind.topic(fleet, message.robot().unwrap_or(0));
            *self.refused.entry(topic).or_default() += 1;
        }
        self.failed |= matches!(&taken, Err(WriteError::Failed { .. }));
        taken
    }

    fn append(
        &mut self,
        fleet: &str,
        times: Times,
        kind: MessageKind,
        message: &Message,
    ) -> Result<(), WriteError> {
        let log_ns = times.log_ns.max(self.log_ns);
        self.log_ns = log_ns;
        if let Some(from_ns) = self.chunk_from_ns
            && log_ns.saturating_sub(from_ns) >= self.settings.chunk_ns
        {
            self.flush()?;
        }
        self.chunk_from_ns.get_or_insert(log_ns);
        let robot = message.robot().unwrap_or(0);
        let place = self.place(fleet, kind, robot)?;
        let channel = &self.channels[&(kind, robot)][place];
        let (channel_id, sequence) = (channel.id, channel.sequence);
        self.scratch.clear();
        message.encode(&mut self.scratch);
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: log_ns,
            publish_time: times.publish_ns,
        };
        self.mcap.write_to_known_channel(&header, &self.scratch).map_err(failed)?;
        self.open.messages += 1;
        self.open.encoded += self.scratch.len() as u64;
        *self.open.by_channel.entry(channel_id).or_default() += 1;
        if let Some(channels) = self.channels.get_mut(&(kind, robot)) {
            channels[place].sequence = sequence.wrapping_add(1);
        }
        Ok(())
    }

    /// Writes the open chunk to the file.
    ///
    /// # Errors
    /// [`WriteError`]. After a failure to write every further call fails.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.check()?;
        self.chunk_from_ns = None;
        let flushed = self.tell_channels().and_then(|()| self.mcap.flush());
        self.failed = flushed.is_err();
        flushed.map_err(failed)?;
        self.messages += self.open.messages;
        self.encoded += self.open.encoded;
        self.index_entries += self.open.by_channel.len() as u64;
        (self.open.messages, self.open.encoded) = (0, 0);
        self.open.by_channel.clear();
        Ok(())
    }

    /// Writes the open chunk, and after it what its channels are, if it opened some or the last
    /// record of all is [`TELL_NS`] old.
    fn tell_channels(&mut self) -> Result<(), McapError> {
        let is_due = self.log_ns.saturating_sub(self.told_ns) >= TELL_NS;
        if self.opened == self.told && !is_due {
            return Ok(());
        }
        let from = if is_due { 0 } else { self.told };
        let mut entries = BTreeMap::new();
        for ((kind, robot), channels) in &self.channels {
            for channel in channels.iter().filter(|channel| usize::from(channel.id) > from) {
                entries.extend(self.schemas.get(kind).map(|schema| {
                    definitions::entry(channel.id, *schema, *kind, &channel.fleet, *robot)
                }));
            }
        }
        self.mcap.write_metadata(&definitions::record(entries))?;
        if is_due {
            self.told_ns = self.log_ns;
        }
        self.told = self.opened;
        Ok(())
    }

    /// Finishes the file with its summary, and returns the statistics, the sequence numbers with
    /// which the channels continue, and the writer.
    ///
    /// # Errors
    /// [`WriteError`]: the summary is incomplete.
    pub fn finish(mut self) -> Result<(Written, Sequences, W), WriteError> {
        self.flush()?;
        self.mcap.finish().map_err(failed)?;
        let (written, sequences) = (self.written(), self.sequences());
        let output = self.mcap.into_inner().into_inner();
        Ok((written, sequences, output.into_inner()))
    }

    /// Bytes of the file so far, without the open chunk.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Entries of the file's index, which stays in memory until the end: one for each channel in each
    /// chunk, some 20 bytes.
    pub const fn index_entries(&self) -> u64 {
        self.index_entries
    }

    /// Writes the open chunk to the file if it spans [`CaptureSettings::chunk_ns`] at `now_ns`
    /// (Unix): to be called while no messages arrive.
    ///
    /// # Errors
    /// As [`Writer::flush`].
    pub fn flush_if_due(&mut self, now_ns: u64) -> Result<(), WriteError> {
        match self.chunk_from_ns {
            Some(from_ns) if now_ns.saturating_sub(from_ns) >= self.settings.chunk_ns => {
                self.flush()
            }
            _ => Ok(()),
        }
    }

    /// Statistics of the file so far.
    pub fn written(&self) -> Written {
        let by_topic = self.topics().map(|(topic, channel)| {
            let before = self.sequences.0.get(&topic).copied().unwrap_or(0);
            let taken = u64::from(channel.sequence.wrapping_sub(before));
            let count = taken - self.open.of(channel);
            (topic, count)
        });
        Written {
            messages: self.messages,
            by_topic: by_topic.collect(),
            bytes: self.bytes(),
            encoded_bytes: self.encoded,
        }
    }

    /// Messages by topic that were passed to [`Writer::write`] and are not in the file: those of
    /// the open chunk, which are lost by a failure, and refused ones.
    pub fn unwritten(&self) -> BTreeMap<String, u64> {
        let mut unwritten = self.refused.clone();
        for (topic, channel) in self.topics() {
            let count = self.open.of(channel);
            if count > 0 {
                *unwritten.entry(topic).or_default() += count;
            }
        }
        unwritten
    }

    fn topics(&self) -> impl Iterator<Item = (String, &Channel)> {
        let channels = self.channels.iter();
        channels.flat_map(|((kind, robot), channels)| {
            let topic = |channel: &Channel| kind.topic(&channel.fleet, *robot);
            channels.iter().map(move |channel| (topic(channel), channel))
        })
    }

    fn sequences(&self) -> Sequences {
        let mut sequences = self.sequences.clone();
        let next = self.topics().map(|(topic, channel)| (topic, channel.sequence));
        sequences.0.extend(next);
        sequences
    }

    const fn check(&self) -> Result<(), WriteError> {
        if self.failed {
            return Err(WriteError::Stopped);
        }
        Ok(())
    }

    /// The channel's index among those of its kind and robot: usually one fleet, at most a few.
    fn place(&mut self, fleet: &str, kind: MessageKind, robot: u32) -> Result<usize, WriteError> {
        let known = self.channels.get(&(kind, robot));
        let known =
            known.and_then(|known| known.iter().position(|channel| &*channel.fleet == fleet));
        match known {
            Some(place) => Ok(place),
            None => self.open_channel(fleet, kind, robot),
        }
    }

    /// Opens the channel and returns its index among those of its kind and robot.
    fn open_channel(
        &mut self,
        fleet: &str,
        kind: MessageKind,
        robot: u32,
    ) -> Result<usize, WriteError> {
        if self.opened == MAX_CHANNELS {
            return Err(WriteError::TooManyChannels { allowed: MAX_CHANNELS });
        }
        let schema = match self.schemas.get(&kind) {
            Some(schema) => *schema,
            None => {
                let data = kind.descriptors();
                let id = self.mcap.add_schema(&kind.schema(), ENCODING, &data).map_err(failed)?;
                let schema = SchemaKey { id, crc: crc32fast::hash(&data) };
                self.schemas.insert(kind, schema);
                schema
            }
        };
        let topic = kind.topic(fleet, robot);
        let metadata = BTreeMap::from([("fleet".to_owned(), fleet.to_owned())]);
        let id = self.mcap.add_channel(schema.id, &topic, ENCODING, &metadata).map_err(failed)?;
        self.opened += 1;
        let channels = self.channels.entry((kind, robot)).or_default();
        channels.push(Channel {
            fleet: Arc::from(fleet),
            id,
            sequence: self.sequences.0.get(&topic).copied().unwrap_or(0),
        });
        Ok(channels.len() - 1)
    }
}

#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
fn failed(error: McapError) -> WriteError {
    WriteError::Failed { reason: reason(&error) }
}
