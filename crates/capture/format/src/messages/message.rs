//! A message, its kind, and what reading one may fail for.

use std::any::Any;
use std::fmt::{self, Debug};
use std::hash::{Hash, Hasher};
use std::sync::Arc;

use joulebus_wire::{Flow, FrameOrder, FrameRows, SentIn};

use super::codec::{Fault, OutOfRange};
use super::wire_fields;

/// A message.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// A message of joulebus: a [`crate::Frame`], a [`crate::RobotRow`] or a [`crate::Query`].
    Known(Box<dyn Content>),
    /// One of another program.
    Other {
        /// Name of its schema. Empty if it has none.
        schema: Arc<str>,
        /// Its bytes.
        data: Vec<u8>,
    },
}

/// Contents of a message.
pub trait Content: Any + Debug + Send + Sync {
    /// Their kind.
    fn kind(&self) -> MessageKind;

    /// The robot, if they concern a single one.
    fn robot(&self) -> Option<u32> {
        None
    }

    /// The order among those of their kind, where there is one.
    fn order(&self) -> Option<FrameOrder> {
        None
    }

    /// When they were sent, monotonic ns, where that is stated.
    fn sent_ns(&self) -> Option<u64> {
        None
    }

    /// Memory that they take elsewhere, bytes.
    fn memory(&self) -> usize {
        0
    }

    /// Appends the protobuf encoding.
    fn encode(&self, out: &mut Vec<u8>);

    /// Calls `take` with each robot's row as a message of its own.
    fn each_robot(&self, _take: &mut dyn FnMut(Message)) {}

    /// A copy.
    fn cloned(&self) -> Box<dyn Content>;

    /// True if the others have the same bits.
    fn is_same(&self, other: &dyn Content) -> bool;

    /// Hashes their bits.
    fn hash_bits(&self, state: &mut dyn Hasher);
}

impl Clone for Box<dyn Content> {
    fn clone(&self) -> Self {
        (**self).cloned()
    }
}

impl PartialEq for dyn Content {
    fn eq(&self, other: &Self) -> bool {
        self.is_same(other)
    }
}

/// Messages of the same bits have the same hash.
impl Hash for Message {
    fn hash<H: Hasher>(&self, state: &mut H) {
        match self {
            Self::Known(content) => {
                content.kind().hash(state);
                content.hash_bits(state);
            }
            Self::Other { schema, data } => (schema, data).hash(state),
        }
    }
}

impl<T: Content> From<T> for Message {
    fn from(content: T) -> Self {
        Self::Known(Box::new(content))
    }
}

impl Message {
    /// Its contents to change, if they are of this type.
    pub fn get_mut<T: Content>(&mut self) -> Option<&mut T> {
        match self {
            Self::Known(content) => (&mut **content as &mut dyn Any).downcast_mut(),
            Self::Other { .. } => None,
        }
    }

    /// Its contents, if they are of this type.
    pub fn get<T: Content>(&self) -> Option<&T> {
        let content: &dyn Any = self.known()?;
        content.downcast_ref()
    }

    /// Same as [`Message::get`], without a copy.
    ///
    /// # Errors
    /// The message, if its contents are others.
    pub fn take<T: Content + Default>(mut self) -> Result<T, Self> {
        match self.get_mut() {
            Some(content) => Ok(std::mem::take(content)),
            None => Err(self),
        }
    }

    fn known(&self) -> Option<&dyn Content> {
        match self {
            Self::Known(content) => Some(&**content),
            Self::Other { .. } => None,
        }
    }

    /// Its kind. `None` for messages of other programs.
    pub fn kind(&self) -> Option<MessageKind> {
        self.known().map(Content::kind)
    }

    /// Its robot, if it concerns a single one.
    pub fn robot(&self) -> Option<u32> {
        self.known()?.robot()
    }

    /// Its order among those of its kind, where there is one.
    pub fn order(&self) -> Option<FrameOrder> {
        self.known()?.order()
    }

    /// Send time, monotonic ns, if it has one. Diagnostics and single robots do not.
    pub fn sent_ns(&self) -> Option<u64> {
        self.known()?.sent_ns()
    }

    /// Its approximate memory, bytes.
    pub fn memory(&self) -> usize {
        match self {
            Self::Known(content) => size_of_val(&**content) + content.memory(),
            Self::Other { data, .. } => data.len(),
        }
    }

    /// Calls `take` with each robot's row as a message of its own. With none if it is no frame of
    /// robots.
    pub fn each_robot(&self, mut take: impl FnMut(Self)) {
        if let Some(content) = self.known() {
            content.each_robot(&mut take);
        }
    }

    /// Appends its protobuf encoding.
    pub fn encode(&self, out: &mut Vec<u8>) {
        match self {
            Self::Known(content) => content.encode(out),
            Self::Other { data, .. } => out.extend_from_slice(data),
        }
    }

    /// Decodes a message from protobuf.
    ///
    /// # Errors
    /// The bytes are not a message of this kind, or a number exceeds its field.
    pub fn decode(kind: MessageKind, data: &[u8]) -> Result<Self, DecodeError> {
        kind.decode(data)
    }
}

/// Maximum number of rows in a message: more than a fleet may have robots. An empty row takes three
/// bytes in a file, and hundreds in memory.
const MAX_ROWS: usize = 1 << 20;

/// The maximum number of rows in a message, or in those within it, `depth` levels down.
pub(super) fn check_rows(data: &[u8], depth: u32) -> Result<usize, DecodeError> {
    match wire_fields::inner(data, depth) {
        found if found > MAX_ROWS => Err(DecodeError::TooManyRows { found }),
        found => Ok(found),
    }
}

pub(super) fn read<T: bytemuck::Pod>(bytes: &[u8]) -> T {
    bytemuck::pod_read_unaligned(bytes)
}

/// Errors of decoding a message.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum DecodeError {
    /// The message has more rows than a fleet may have robots.
    #[error("{found} rows, allowed are {MAX_ROWS}, more than the robots of any fleet")]
    TooManyRows { found: usize },
    /// Not protobuf, or not of this kind.
    #[error("{reason}")]
    Protobuf { reason: String },
    /// A number that exceeds its field.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
}

impl From<Fault> for DecodeError {
    fn from(fault: Fault) -> Self {
        Self::Protobuf { reason: fault.to_string() }
    }
}

/// A message with its topic and times.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Topic of its channel: `joulebus/<fleet>/<service>`.
    pub topic: Arc<str>,
    /// The fleet. Empty for messages of other programs.
    pub fleet: Arc<str>,
    /// When the recorder received it, Unix ns.
    pub log_time_ns: u64,
    /// When it was sent, Unix ns.
    pub publish_time_ns: u64,
    /// Its sequence number in the channel, from 0. Continues over split files and wraps after 2^32.
    pub sequence: u32,
    /// Its contents.
    pub message: Message,
}

/// Kind of the messages of a topic: frames of a channel, single robots' rows of them, or questions
/// with their answers.
#[derive(Clone, Copy)]
pub struct MessageKind {
    /// Name of the channel's service.
    pub(super) name: &'static str,
    /// Name of the message, without its package: unique.
    pub(super) message: &'static str,
    pub(super) is_of_robot: bool,
    pub(super) flow: Flow,
    pub(super) sent_in: SentIn,
    pub(super) rows: FrameRows,
    pub(super) decode: fn(&[u8]) -> Result<Message, DecodeError>,
    pub(super) descriptors: fn(&str) -> Vec<u8>,
}

impl MessageKind {
    /// The senders and readers of the channel.
    #[must_use]
    pub const fn flow(self) -> Flow {
        self.flow
    }

    /// The meaning of the channel's rows.
    #[must_use]
    pub const fn rows(self) -> FrameRows {
        self.rows
    }

    /// True if captures may have its rows as messages of single robots: the worker sends them, read
    /// or not.
    pub const fn has_robots(self) -> bool {
        matches!(self.rows, FrameRows::Robots) && !self.flow.is_on_demand()
    }

    /// The name of the service.
    pub const fn name(self) -> &'static str {
        self.name
    }

    /// The name of the schema.
    #[must_use]
    pub fn schema(self) -> String {
        format!("joulebus.{}", self.message)
    }

    /// The protobuf file set that describes the messages: the schema's data.
    pub fn descriptors(self) -> Vec<u8> {
        (self.descriptors)(self.message)
    }

    /// True if its schema has this name.
    #[must_use]
    pub fn is_schema(self, name: &str) -> bool {
        name.strip_prefix("joulebus.") == Some(self.message)
    }

    /// The channel's topic. `robot` is used only by kinds of single robots.
    #[must_use]
    pub fn topic(self, fleet: &str, robot: u32) -> String {
        if self.is_of_robot {
            format!("joulebus/{fleet}/robot/{robot}/{}", self.message_name())
        } else {
            format!("joulebus/{fleet}/{}", self.name)
        }
    }

    /// The name of the message in small letters: `plan_state`.
    #[must_use]
    pub fn message_name(self) -> String {
        let mut name = String::new();
        for letter in self.message.chars() {
            if letter.is_ascii_uppercase() && !name.is_empty() {
                name.push('_');
            }
            name.push(letter.to_ascii_lowercase());
        }
        name
    }

    pub(super) fn decode(self, data: &[u8]) -> Result<Message, DecodeError> {
        (self.decode)(data)
    }
}

impl PartialEq for MessageKind {
    fn eq(&self, other: &Self) -> bool {
        self.message == other.message
    }
}

impl Eq for MessageKind {}

impl Hash for MessageKind {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.message.hash(state);
    }
}

impl fmt::Debug for MessageKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.message)
    }
}
