//! Reads captures, one message at a time.

use std::collections::HashMap;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use joulebus_files::foreign;
use mcap::McapError;
use mcap::records::{MessageHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::chunk::{self, Records};
use crate::definitions::CHANNELS;
use crate::scan::{MAX_RECORD_BYTES, max_expanded, parse_record};
use crate::{Attached, Attachments, DecodeError, Entry, Message, MessageKind};

/// Maximum number of bytes per read.
const MAX_AT_ONCE: usize = 1 << 18;

/// Reads a capture from its beginning, in memory of about its largest chunk. Messages are returned
/// in the order of the file, which in our captures is that of their log time.
///
/// A file without its end (the recorder was killed, the disk was full) is read up to there,
/// followed by [`ReadError::Truncated`].
pub struct Reader<S> {
    source: S,
    mcap: LinearReader,
    /// Unread records of the last chunk.
    records: Records,
    contents: Contents,
    /// The first message, read while searching for attachments.
    first: Option<(MessageHeader, Vec<u8>)>,
    read_bytes: u64,
    /// Bytes of decompressed records so far.
    expanded_bytes: u64,
    done: bool,
}

impl<S> fmt::Debug for Reader<S> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Reader")
            .field("attachments", &self.contents.attachments)
            .field("read_bytes", &self.read_bytes)
            .field("done", &self.done)
            .finish_non_exhaustive()
    }
}

/// Records before the messages of a file.
#[derive(Default)]
struct Contents {
    schemas: HashMap<u16, Arc<str>>,
    channels: HashMap<u16, Channel>,
    attachments: Attachments,
    /// Kinds of channels that are declared elsewhere.
    kinds: Vec<MessageKind>,
}

struct Channel {
    topic: Arc<str>,
    fleet: Arc<str>,
    schema: Arc<str>,
    /// None for messages of other programs.
    kind: Option<MessageKind>,
    is_protobuf: bool,
    /// The fleet that the file names.
    of_fleet: Arc<str>,
}

impl Reader<File> {
    /// Opens a regular file and reads the records before the first message. For streams use
    /// [`Reader::new`].
    ///
    /// # Errors
    /// [`ReadError`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ReadError> {
        let path = path.as_ref();
        let opened = Self::new(joulebus_files::open(path)?);
        opened.map_err(|error| match (error, foreign::of_file(path)) {
            (ReadError::Damaged { .. }, Some(kind)) if kind.what != foreign::MCAP => {
                let found = kind.to_string();
                ReadError::Foreign { found }
            }
            (error, _) => error,
        })
    }
}

impl<S: Read> Reader<S> {
    /// Reads the records before the first message: attachments and metadata are then available.
    ///
    /// # Errors
    /// [`ReadError`].
    pub fn new(source: S) -> Result<Self, ReadError> {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_record_length_limit(MAX_RECORD_BYTES as usize);
        let mut reader = Self {
            source,
            mcap: LinearReader::new_with_options(options),
            records: Records::default(),
            contents: Contents::default(),
            first: None,
            read_bytes: 0,
            expanded_bytes: 0,
            done: false,
        };
        reader.first = match reader.advance() {
            Ok(found) => found,
            // The records before the end are usable.
            Err(ReadError::Truncated { .. }) if reader.read_bytes > 0 => None,
            Err(error) => return Err(error),
        };
        Ok(reader)
    }

    /// Also reads messages of these kinds: those of channels that are declared elsewhere.
    #[must_use]
    pub fn with_kinds(mut self, kinds: impl IntoIterator<Item = MessageKind>) -> Self {
        let Contents { channels, kinds: known, .. } = &mut self.contents;
        known.extend(kinds);
        channels.values_mut().for_each(|channel| channel.find_kind(known));
        self
    }

    /// Config, models and build, and the file's metadata. In files of other programs only those
    /// before the first message.
    pub const fn attachments(&self) -> &Attachments {
        &self.contents.attachments
    }

    /// The next message. `None` at the end of a complete file.
    ///
    /// # Errors
    /// [`ReadError`]. After [`ReadError::Message`] the next message can be read, after the others
    /// nothing can.
    pub fn next_entry(&mut self) -> Result<Option<Entry>, ReadError> {
        let found = match self.first.take() {
            Some(found) => Some(found),
            None if self.done => None,
            None => self.advance().inspect_err(|_| self.done = true)?,
        };
        match found {
            Some((header, data)) => self.entry(header, &data).map(Some),
            None => {
                self.done = true;
                Ok(None)
            }
        }
    }

    fn entry(&self, header: MessageHeader, data: &[u8]) -> Result<Entry, ReadError> {
        let Some(channel) = self.contents.channels.get(&header.channel_id) else {
            let (sequence, id) = (header.sequence, header.channel_id);
            let error = McapError::UnknownChannel(sequence, id);
            return Err(damage(error, self.read_bytes));
        };
        let message = match channel.kind {
            Some(kind) => Message::decode(kind, data).map_err(|source| ReadError::Message {
                topic: channel.topic.to_string(),
                sequence: header.sequence,
                source,
            })?,
            None => Message::Other { schema: Arc::clone(&channel.schema), data: data.to_vec() },
        };
        Ok(Entry {
            topic: Arc::clone(&channel.topic),
            fleet: Arc::clone(&channel.fleet),
            log_time_ns: header.log_time,
            publish_time_ns: header.publish_time,
            sequence: header.sequence,
            message,
        })
    }

    /// Reads up to the next message.
    fn advance(&mut self) -> Result<Option<(MessageHeader, Vec<u8>)>, ReadError> {
        loop {
            while let Some(record) = self.records.next() {
                let taken = record.and_then(|(opcode, body)| self.contents.take(opcode, body));
                let found = taken.map_err(|error| damage(error, self.read_bytes))?;
                if found.is_some() {
                    return Ok(found);
                }
            }
            let Some(event) = self.mcap.next_event() else {
                return Ok(None);
            };
            let taken = match event.map_err(|error| damage(error, self.read_bytes))? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let buffer = self.mcap.insert(wanted.clamp(1, MAX_AT_ONCE));
                    let read = self.source.read(buffer)?;
                    self.mcap.notify_read(read);
                    self.read_bytes += read as u64;
                    continue;
                }
                LinearReadEvent::Record { opcode, data } if opcode == op::CHUNK => {
                    let allowed = max_expanded(self.read_bytes);
                    let left = allowed.saturating_sub(self.expanded_bytes);
                    chunk::records(data, left).map(|records| {
                        self.expanded_bytes += records.bytes();
                        self.records = records;
                        None
                    })
                }
                LinearReadEvent::Record { opcode, data } => self.contents.take(opcode, data),
            };
            let found = taken.map_err(|error| damage(error, self.read_bytes))?;
            if found.is_some() {
                return Ok(found);
            }
        }
    }
}

impl Contents {
    /// Processes a record. Returns it if it is a message.
    fn take(
        &mut self,
        opcode: u8,
        data: &[u8],
    ) -> Result<Option<(MessageHeader, Vec<u8>)>, McapError> {
        let record = parse_record(opcode, data);
        match record.map_err(|error| error.unwrap_or(McapError::UnexpectedEoc))? {
            Record::Message { header, data } => return Ok(Some((header, data.into_owned()))),
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name.into());
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned();
                let schema = schema.unwrap_or_default();
                let channel_of = Channel::new(&channel, schema, &self.kinds);
                self.channels.insert(channel.id, channel_of);
            }
            Record::Attachment { header, data, .. } => {
                self.attachments.created_unix_ns = header.create_time;
                self.attachments.files.push(Attached {
                    name: header.name,
                    media_type: header.media_type,
                    bytes: data.into_owned(),
                });
            }
            Record::Metadata(metadata) if metadata.name != CHANNELS => {
                let records = &mut self.attachments.metadata;
                records.insert(metadata.name, metadata.metadata);
            }
            _ => {}
        }
        Ok(None)
    }
}

impl<S: Read> Iterator for Reader<S> {
    type Item = Result<Entry, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_entry().transpose()
    }
}

impl Channel {
    fn new(channel: &mcap::records::Channel, schema: Arc<str>, kinds: &[MessageKind]) -> Self {
        let fleet = channel.metadata.get("fleet").map_or("", String::as_str);
        let mut of = Self {
            topic: channel.topic.as_str().into(),
            fleet: Arc::default(),
            schema,
            kind: None,
            is_protobuf: channel.message_encoding == "protobuf",
            of_fleet: fleet.into(),
        };
        of.find_kind(kinds);
        of
    }

    /// Sets the kind, if it is one of ours or one of `others`.
    fn find_kind(&mut self, others: &[MessageKind]) {
        let mut kinds = MessageKind::all().chain(others.iter().copied());
        self.kind = kinds.find(|kind| self.is_protobuf && kind.is_schema(&self.schema));
        if self.kind.is_some() {
            self.fleet = Arc::clone(&self.of_fleet);
        }
    }
}

fn damage(error: McapError, read_bytes: u64) -> ReadError {
    match error {
        McapError::UnexpectedEof => ReadError::Truncated { bytes: read_bytes },
        error => ReadError::Damaged { detail: error.to_string() },
    }
}

/// Errors of reading a capture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ReadError {
    /// The file could not be opened or read.
    #[error("cannot read the capture: {0}")]
    Io(#[from] std::io::Error),
    /// The file is truncated: its recorder was killed, or its disk was full. All messages before
    /// are valid.
    #[error(
        "the capture ends after {bytes} bytes without its last records. `joulebus recover` makes \
         it whole"
    )]
    Truncated { bytes: u64 },
    /// The file is of another program.
    #[error("found {found}, expected a capture of joulebus (.mcap)")]
    Foreign {
        /// The kind of file that it is, with the remedy.
        found: String,
    },
    /// The file is corrupt, or not a capture.
    #[error("the capture is damaged: {detail}. `joulebus recover` saves what can be read")]
    Damaged { detail: String },
    /// A message does not match its channel's schema. The next one can be read.
    #[error("message {sequence} of {topic} cannot be read: {source}")]
    Message { topic: String, sequence: u32, source: DecodeError },
}
