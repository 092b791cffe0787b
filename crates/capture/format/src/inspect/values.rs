//! Decodes the values in messages of any MCAP file by its schemas.
//!
//! Protobuf messages are decoded by the descriptors in the file, JSON is passed on unchanged, and
//! the ROS types of `joulebus-ros-messages` are decoded from CDR. For other messages only time,
//! sequence number and length are available.

use std::collections::BTreeMap;
use std::io::{Read, Seek};
use std::rc::Rc;

use mcap::records::{MessageHeader, Record};
use prost_reflect::{DescriptorPool, DynamicMessage, Kind, MessageDescriptor, SerializeOptions};
use serde::Serialize;
use serde_json::Value;

use crate::messages::wire_fields::{Field, Fields, Payload};
use crate::scan::{ScanError, each_record};
use joulebus_ros_messages as ros;

/// Maximum nesting depth of fields listed as columns.
const MAX_DEPTH: usize = 8;
/// Maximum length of all names of columns, bytes: a message that contains itself has more than can
/// be listed.
const MAX_COLUMN_BYTES: usize = 1 << 20;
/// Maximum number of values in a message that is decoded, those that it leaves out included: a row
/// of a hundred thousand robots has some fifty. An empty message within another takes one byte in a
/// file, and hundreds in memory.
const MAX_VALUES: usize = 1 << 23;
/// Cost of a nested message beside its values, in values.
const MESSAGE_VALUES: usize = 8;
/// Maximum nesting depth of a message that is decoded, that of the decoder.
const MAX_DECODED_DEPTH: usize = 100;

/// A message with its values.
#[derive(Debug, Serialize)]
pub struct Line<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// Name of its schema. Empty if it has none.
    pub schema: &'a str,
    /// When it was recorded, ns.
    pub log_time_ns: u64,
    /// When it was sent, ns.
    pub publish_time_ns: u64,
    /// Its sequence number.
    pub sequence: u32,
    /// Its length, bytes.
    pub bytes: usize,
    /// Its values. `null` if they cannot be decoded.
    pub value: Value,
    /// The reason why they cannot be decoded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub undecoded: Option<String>,
    /// Names of its fields, in the order of the schema. Protobuf only.
    #[serde(skip)]
    pub columns: &'a [String],
}

/// Result of reading a file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Passed {
    /// Messages passed on.
    pub messages: u64,
    /// Messages whose values could not be decoded, by topic.
    pub undecoded: BTreeMap<String, u64>,
    /// Damage of the file.
    pub damage: Vec<String>,
}

/// Decoder of a channel's messages.
enum How {
    Protobuf(MessageDescriptor),
    Json,
    Ros(ros::RosType),
    Unknown(String),
}

struct Channel {
    topic: String,
    schema: Rc<str>,
    columns: Rc<[String]>,
    how: How,
    wanted: bool,
}

/// A schema, and its message once a channel has needed it: many channels may have one.
#[derive(Default)]
struct Schema {
    name: Rc<str>,
    encoding: String,
    data: Vec<u8>,
    message: Option<Result<Described, String>>,
}

/// A message by the file's descriptors, and its columns.
#[derive(Clone)]
struct Described {
    message: MessageDescriptor,
    columns: Rc<[String]>,
}

/// Reads a file and passes on the messages of the `wanted` topics, in the order of the file.
///
/// # Errors
/// Errors of `take`, or [`ScanError`] if the file is not an MCAP file or cannot be read. Damage is
/// skipped and listed in [`Passed`].
pub fn values<E: From<ScanError>>(
    input: impl Read + Seek,
    wanted: impl Fn(&str) -> bool,
    mut take: impl FnMut(Line<'_>) -> Result<(), E>,
) -> Result<Passed, E> {
    let mut schemas = BTreeMap::new();
    let mut channels: BTreeMap<u16, Channel> = BTreeMap::new();
    let mut passed = Passed::default();
    passed.damage = each_record::<E>(input, |record| {
        match record {
            Record::Schema { header, data } => {
                schemas.entry(header.id).or_insert_with(|| Schema {
                    name: header.name.into(),
                    encoding: header.encoding,
                    data: data.into_owned(),
                    message: None,
                });
            }
            Record::Channel(channel) => {
                channels.entry(channel.id).or_insert_with(|| {
                    let schema = schemas.get_mut(&channel.schema_id);
                    Channel::new(channel, schema.unwrap_or(&mut Schema::default()), &wanted)
                });
            }
            Record::Message { header, data } => {
                if let Some(channel) =
                    channels.get(&header.channel_id).filter(|channel| channel.wanted)
                {
                    let line = channel.line(&header, &data);
                    passed.messages += 1;
                    if line.undecoded.is_some() {
                        *passed.undecoded.entry(channel.topic.clone()).or_default() += 1;
                    }
                    take(line)?;
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok(passed)
}

impl Channel {
    fn new(
        channel: mcap::records::Channel,
        schema: &mut Schema,
        wanted: impl Fn(&str) -> bool,
    ) -> Self {
        let mut columns = Rc::from([]);
        let how = match channel.message_encoding.as_str() {
            "protobuf" => match schema.described() {
                Ok(described) => {
                    columns = described.columns;
                    How::Protobuf(described.message)
                }
                Err(why) => How::Unknown(why),
            },
            "json" => How::Json,
            other => match ros::RosType::new(other, &schema.name, &schema.encoding, &schema.data) {
                Ok(kind) => How::Ros(kind),
                Err(error) => How::Unknown(error.to_string()),
            },
        };
        Self {
            wanted: wanted(&channel.topic),
            topic: channel.topic,
            schema: Rc::clone(&schema.name),
            columns,
            how,
        }
    }

    fn line(&self, header: &MessageHeader, data: &[u8]) -> Line<'_> {
        let (value, undecoded) = match self.decode(data) {
            Ok(value) => (value, None),
            Err(why) => (Value::Null, Some(why)),
        };
        Line {
            topic: &self.topic,
            schema: &self.schema,
            log_time_ns: header.log_time,
            publish_time_ns: header.publish_time,
            sequence: header.sequence,
            bytes: data.len(),
            value,
            undecoded,
            columns: &self.columns,
        }
    }

    fn decode(&self, data: &[u8]) -> Result<Value, String> {
        match &self.how {
            How::Protobuf(descriptor) => {
                let mut left = MAX_VALUES;
                count(descriptor, data, MAX_DECODED_DEPTH, &mut left)?;
                let message = DynamicMessage::decode(descriptor.clone(), data)
                    .map_err(|error| error.to_string())?;
                // Field names as in the schema, zeros included. 64-bit numbers as numbers.
                let options = SerializeOptions::new()
                    .use_proto_field_name(true)
                    .stringify_64_bit_integers(false)
                    .skip_default_fields(false);
                message
                    .serialize_with_options(serde_json::value::Serializer, &options)
                    .map_err(|error| error.to_string())
            }
            How::Json => serde_json::from_slice(data).map_err(|error| error.to_string()),
            How::Ros(kind) => {
                let message = kind.decode(data).map_err(|error| error.to_string())?;
                serde_json::to_value(message).map_err(|error| error.to_string())
            }
            How::Unknown(why) => Err(why.clone()),
        }
    }
}

/// The file's descriptor of a message.
fn descriptor(name: &str, encoding: &str, data: &[u8]) -> Result<MessageDescriptor, String> {
    if encoding != "protobuf" {
        return Err(format!("schema encoding {encoding:?}, read is \"protobuf\""));
    }
    let pool = DescriptorPool::decode(data).map_err(|error| error.to_string())?;
    pool.get_message_by_name(name)
        .ok_or_else(|| format!("its descriptors have no message {name:?}"))
}

impl Schema {
    /// Its message by the descriptors, decoded once.
    fn described(&mut self) -> Result<Described, String> {
        let Self { name, encoding, data, message } = self;
        let described = message.get_or_insert_with(|| {
            let message = descriptor(name, encoding, data)?;
            let (mut columns, mut left) = (Vec::new(), MAX_COLUMN_BYTES);
            list(&message, "", 0, &mut columns, &mut left);
            let columns = columns.into();
            Ok(Described { message, columns })
        });
        described.clone()
    }
}

/// Takes the values that a message will have in memory off `left`, by its encoding alone.
///
/// # Errors
/// There are more, or something that is not decoded.
fn count(
    message: &MessageDescriptor,
    data: &[u8],
    depth: usize,
    left: &mut usize,
) -> Result<(), String> {
    take(left, MESSAGE_VALUES + message.fields().len())?;
    for Field { number, payload } in Fields(data) {
        let kind = message.get_field(number).map(|field| field.kind());
        match (payload, kind) {
            (Payload::Bytes(bytes), Some(Kind::Message(inner))) => {
                let depth = depth.checked_sub(1);
                let depth =
                    depth.ok_or_else(|| format!("nested deeper than {MAX_DECODED_DEPTH}"))?;
                count(&inner, bytes, depth, left)?;
            }
            (Payload::Bytes(_), None | Some(Kind::String | Kind::Bytes)) | (Payload::Number, _) => {
                take(left, 1)?;
            }
            // Numbers one after the other: at most one for each byte.
            (Payload::Bytes(bytes), Some(_)) => take(left, bytes.len())?,
            (Payload::Group, _) => return Err("groups are not decoded".to_owned()),
        }
    }
    Ok(())
}

fn take(left: &mut usize, values: usize) -> Result<(), String> {
    let rest = left.checked_sub(values).ok_or_else(|| {
        format!("more than {MAX_VALUES} values, those left out included, which is the limit")
    });
    *left = rest?;
    Ok(())
}

/// The scalar fields of a message as dotted paths, as many as `left` bytes of names allow. Those of
/// repeated messages without an index.
fn list(
    message: &MessageDescriptor,
    before: &str,
    depth: usize,
    columns: &mut Vec<String>,
    left: &mut usize,
) {
    for field in message.fields() {
        let name = format!("{before}{}", field.name());
        let Some(rest) = left.checked_sub(name.len()) else {
            return;
        };
        *left = rest;
        match field.kind() {
            Kind::Message(inner) if !is_text(&inner) && !field.is_map() => {
                if depth < MAX_DEPTH {
                    list(&inner, &format!("{name}."), depth + 1, columns, left);
                }
            }
            _ => columns.push(name),
        }
    }
}

/// Messages that JSON represents as a string.
fn is_text(message: &MessageDescriptor) -> bool {
    matches!(message.full_name(), "google.protobuf.Timestamp" | "google.protobuf.Duration")
}
