//! Decodes the values in messages of any MCAP file by its schemas.
//!
//! Protobuf messages are decoded by the descriptors in the file, JSON is passed on unchanged, and
//! the ROS types of [`crate::ros`] are decoded from CDR. For other messages only time, sequence
//! number and length are available.

use std::collections::BTreeMap;
use std::io::{Read, Seek};

use mcap::records::{MessageHeader, Record};
use prost_reflect::{DescriptorPool, DynamicMessage, Kind, MessageDescriptor, SerializeOptions};
use serde::Serialize;
use serde_json::Value;

use crate::ros;
use crate::scan::{ScanError, each_record};

/// Maximum nesting depth of fields listed as columns.
const MOST_DEPTH: usize = 8;

/// A message with its values.
#[derive(Debug, Serialize)]
pub struct Line<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// Name of its schema; empty if it has none.
    pub schema: &'a str,
    /// When it was recorded, ns.
    pub log_time_ns: u64,
    /// When it was sent, ns.
    pub publish_time_ns: u64,
    /// Its sequence number.
    pub sequence: u32,
    /// Its length, bytes.
    pub bytes: usize,
    /// Its values; `null` if they cannot be decoded.
    pub value: Value,
    /// The reason why they cannot be decoded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub undecoded: Option<String>,
    /// Names of its fields, in the order of the schema; protobuf only.
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
    schema: String,
    columns: Vec<String>,
    how: How,
    wanted: bool,
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
                schemas
                    .entry(header.id)
                    .or_insert_with(|| (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(channel) => {
                let id = channel.id;
                channels
                    .entry(id)
                    .or_insert_with(|| Channel::new(channel, &schemas, &wanted));
            }
            Record::Message { header, data } => {
                if let Some(channel) = channels
                    .get(&header.channel_id)
                    .filter(|channel| channel.wanted)
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
        schemas: &BTreeMap<u16, (String, String, Vec<u8>)>,
        wanted: impl Fn(&str) -> bool,
    ) -> Self {
        let empty = (String::new(), String::new(), Vec::new());
        let (schema, encoding, data) = schemas.get(&channel.schema_id).unwrap_or(&empty);
        let how = match channel.message_encoding.as_str() {
            "protobuf" => match descriptor(schema, encoding, data) {
                Ok(descriptor) => How::Protobuf(descriptor),
                Err(why) => How::Unknown(why),
            },
            "json" => How::Json,
            other => match ros::RosType::of(other, schema, encoding, data) {
                Ok(kind) => How::Ros(kind),
                Err(error) => How::Unknown(error.to_string()),
            },
        };
        let mut columns = Vec::new();
        if let How::Protobuf(descriptor) = &how {
            list(descriptor, "", 0, &mut columns);
        }
        Self {
            wanted: wanted(&channel.topic),
            topic: channel.topic,
            schema: schema.clone(),
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
                let message = DynamicMessage::decode(descriptor.clone(), data)
                    .map_err(|error| error.to_string())?;
                // Field names as in the schema, zeros included; 64-bit numbers as numbers.
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
        return Err(format!(
            "schema encoding {encoding:?}; read is \"protobuf\""
        ));
    }
    let pool = DescriptorPool::decode(data).map_err(|error| error.to_string())?;
    pool.get_message_by_name(name)
        .ok_or_else(|| format!("its descriptors have no message {name:?}"))
}

/// The scalar fields of a message as dotted paths; those of repeated messages without an index.
fn list(message: &MessageDescriptor, before: &str, depth: usize, columns: &mut Vec<String>) {
    for field in message.fields() {
        let name = format!("{before}{}", field.name());
        match field.kind() {
            Kind::Message(inner) if !is_text(&inner) && !field.is_map() => {
                if depth < MOST_DEPTH {
                    list(&inner, &format!("{name}."), depth + 1, columns);
                }
            }
            _ => columns.push(name),
        }
    }
}

/// Messages that JSON represents as a string.
fn is_text(message: &MessageDescriptor) -> bool {
    matches!(
        message.full_name(),
        "google.protobuf.Timestamp" | "google.protobuf.Duration"
    )
}
