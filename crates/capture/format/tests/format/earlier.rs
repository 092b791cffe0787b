//! A capture that the release of 24 November 2026 (df6ba14) would have written, by its code: it is read to the same bits, and
//! written the same.

use std::collections::BTreeMap;
use std::io::Cursor;

use joulebus_capture_format::{Attachments, CaptureSettings, Message, Preset, Reader, Times, Writer};

use crate::fields::{Bits, assert_same_bits, messages};

const EARLIER: &[u8] = include_bytes!("../earlier.mcap");

fn written() -> Vec<Message> {
    (0..3).flat_map(|seed| messages(&mut Bits(seed))).collect()
}

fn write(messages: &[Message]) -> Vec<u8> {
    let settings = CaptureSettings::of(Preset::FastWrite);
    let mut writer = Writer::new(Vec::new(), settings, &Attachments::default()).unwrap();
    for (number, message) in messages.iter().enumerate() {
        let times = Times {
            log_ns: 1_000_000_000 + number as u64 * 7_000_000,
            publish_ns: number as u64,
        };
        writer.write("lab", times, message).unwrap();
    }
    writer.finish().unwrap().2
}

/// Topic, schema and contents of each message, and the schemas.
fn contents(file: &[u8]) -> (Vec<(String, Vec<u8>)>, BTreeMap<String, Vec<u8>>) {
    let (mut data, mut schemas) = (Vec::new(), BTreeMap::new());
    for message in mcap::MessageStream::new(file).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        schemas.insert(schema.name.clone(), schema.data.to_vec());
        let topic = format!("{} {}", message.channel.topic, schema.name);
        data.push((topic, message.data.to_vec()));
    }
    (data, schemas)
}

#[test]
fn an_earlier_capture_is_read_to_the_same_bits() {
    let mut reader = Reader::new(Cursor::new(EARLIER)).unwrap();
    for message in &written() {
        let entry = reader.next_entry().unwrap().unwrap();
        assert_same_bits(&entry.message, message);
    }
    assert!(reader.next_entry().unwrap().is_none());
}

#[test]
fn the_same_messages_and_schemas_are_written_as_earlier() {
    if let Some(path) = std::env::var_os("JOULEBUS_WRITE_EARLIER") {
        std::fs::write(path, write(&written())).unwrap();
    }
    let (earlier, now) = (contents(EARLIER), contents(&write(&written())));
    assert_eq!(earlier.0.len(), 3 * 12);
    assert!(earlier == now, "the encoding has changed");
}
