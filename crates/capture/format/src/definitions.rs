//! What the channels of a capture are, told a second time outside of its chunks.
//!
//! A channel and its schema are defined once, in the chunk of its first message. Without that chunk
//! no message of the whole file could be assigned. So a metadata record, [`CHANNELS`], tells the
//! channels again: the new ones after the chunk that defines them, and all once a minute.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use mcap::records::{Channel, Metadata};

use crate::MessageKind;

/// Name of the metadata records.
pub(crate) const CHANNELS: &str = "joulebus.channels";
/// Key of the checksum of the other entries: a metadata record has none.
const CRC: &str = "crc32";

/// Name, encoding and data of a schema.
pub(crate) type SchemaText = (String, String, Vec<u8>);

/// Schemas and channels by their ids.
#[derive(Debug, Default)]
pub(crate) struct Definitions {
    pub(crate) schemas: BTreeMap<u16, SchemaText>,
    pub(crate) channels: BTreeMap<u16, Channel>,
}

/// A schema of a file: its id, and the checksum of its data.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SchemaKey {
    pub(crate) id: u16,
    pub(crate) crc: u32,
}

/// The entry of a channel in a metadata record. Names of fleets have no spaces.
pub(crate) fn entry(
    channel: u16,
    SchemaKey { id, crc }: SchemaKey,
    kind: MessageKind,
    fleet: &str,
    robot: u32,
) -> (String, String) {
    let topic = kind.topic(fleet, robot);
    (channel.to_string(), format!("{id} {crc:08x} {} {fleet} {topic}", kind.schema()))
}

/// The record of these entries.
pub(crate) fn record(mut metadata: BTreeMap<String, String>) -> Metadata {
    metadata.insert(CRC.to_owned(), checksum(&metadata));
    Metadata { name: CHANNELS.to_owned(), metadata }
}

fn checksum(entries: &BTreeMap<String, String>) -> String {
    let mut crc = crc32fast::Hasher::new();
    for (key, value) in entries.iter().filter(|(key, _)| *key != CRC) {
        crc.update(key.as_bytes());
        crc.update(value.as_bytes());
    }
    format!("{:08x}", crc.finalize())
}

impl Definitions {
    /// Adds what a metadata record tells, if it is one of [`CHANNELS`], with its checksum. A schema
    /// that this program has not in the same bytes is left out, with its channels.
    pub(crate) fn add(&mut self, record: &Metadata) {
        let is_whole = record.metadata.get(CRC) == Some(&checksum(&record.metadata));
        if record.name != CHANNELS || !is_whole {
            return;
        }
        for (id, entry) in &record.metadata {
            let words: Vec<&str> = entry.splitn(5, ' ').collect();
            let (Ok(id), &[schema, crc, name, fleet, topic]) = (id.parse(), &words[..]) else {
                continue;
            };
            let Ok(schema_id) = schema.parse() else {
                continue;
            };
            if let Entry::Vacant(place) = self.schemas.entry(schema_id) {
                let kind = MessageKind::all().find(|kind| kind.schema() == name);
                let data = kind.map(MessageKind::descriptors);
                let data = data.filter(|data| format!("{:08x}", crc32fast::hash(data)) == crc);
                let Some(data) = data else {
                    continue;
                };
                place.insert((name.to_owned(), ENCODING.to_owned(), data));
            }
            let metadata = BTreeMap::from([("fleet".to_owned(), fleet.to_owned())]);
            let (topic, message_encoding) = (topic.to_owned(), ENCODING.to_owned());
            let channel = Channel { id, schema_id, topic, message_encoding, metadata };
            self.channels.insert(id, channel);
        }
    }
}

/// Encoding of our schemas and messages.
pub(crate) const ENCODING: &str = "protobuf";
