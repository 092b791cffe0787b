//! Every combination of the optional parts of the format is read as described.

use std::fs::{self, File};
use std::path::Path;

use joulebus_capture_format::scan::{Event, Scan};
use joulebus_testkit::recordings::shared;
use mcap::records::Record;
use serde_json::{Map, Value, json};

#[test]
fn the_416_conformance_files_are_read_as_they_are_described() {
    let Some(folder) = shared("mcap/conformance") else {
        return;
    };
    let mut files = 0;
    for variant in fs::read_dir(folder).unwrap() {
        let variant = variant.unwrap().path();
        if !variant.is_dir() {
            continue;
        }
        for file in fs::read_dir(variant).unwrap() {
            let file = file.unwrap().path();
            if file.extension().is_some_and(|extension| extension == "mcap") {
                check(&file);
                files += 1;
            }
        }
    }
    assert_eq!(files, 416);
    println!("figure: {files} conformance files read as described, 0 differ");
}

fn check(file: &Path) {
    let described: Value =
        serde_json::from_slice(&fs::read(file.with_extension("json")).unwrap()).unwrap();
    let mut scan = Scan::new(File::open(file).unwrap()).unwrap();
    let mut found = Vec::new();
    loop {
        match scan.next_event() {
            Ok(Some(Event::Record(raw))) => {
                assert!(raw.crc.is_none_or(|crc| !crc.is_wrong()), "{}", file.display());
                found.extend(in_json(raw.parse().unwrap()));
            }
            Ok(Some(Event::ChunkEnds { crc, .. })) => assert!(!crc.is_wrong()),
            Ok(Some(Event::ChunkBegins(_))) => {}
            Ok(Some(other)) => panic!("{}: {other:?}", file.display()),
            Ok(None) => break,
            Err(error) => panic!("{}: {error}", file.display()),
        }
    }
    assert_eq!(Value::Array(found), described["records"], "{}", file.display());
}

fn number<N: Copy + ToString>(value: N) -> Value {
    Value::String(value.to_string())
}

fn bytes(bytes: &[u8]) -> Value {
    bytes.iter().copied().map(number).collect()
}

fn counts(map: &std::collections::BTreeMap<u16, u64>) -> Value {
    let entry = |(key, value): (&u16, &u64)| (key.to_string(), number(*value));
    Value::Object(map.iter().map(entry).collect::<Map<_, _>>())
}

/// A record in the format of the descriptions, which omit message indexes.
fn in_json(record: Record<'_>) -> Option<Value> {
    let (kind, fields) = match record {
        Record::Header(header) => {
            ("Header", json!([["library", header.library], ["profile", header.profile]]))
        }
        Record::Footer(footer) => (
            "Footer",
            json!([
                ["summary_crc", number(footer.summary_crc)],
                ["summary_offset_start", number(footer.summary_offset_start)],
                ["summary_start", number(footer.summary_start)],
            ]),
        ),
        Record::Schema { header, data } => (
            "Schema",
            json!([
                ["data", bytes(&data)],
                ["encoding", header.encoding],
                ["id", number(header.id)],
                ["name", header.name],
            ]),
        ),
        Record::Channel(channel) => (
            "Channel",
            json!([
                ["id", number(channel.id)],
                ["message_encoding", channel.message_encoding],
                ["metadata", channel.metadata],
                ["schema_id", number(channel.schema_id)],
                ["topic", channel.topic],
            ]),
        ),
        Record::Message { header, data } => (
            "Message",
            json!([
                ["channel_id", number(header.channel_id)],
                ["data", bytes(&data)],
                ["log_time", number(header.log_time)],
                ["publish_time", number(header.publish_time)],
                ["sequence", number(header.sequence)],
            ]),
        ),
        Record::Attachment { header, data, .. } => (
            "Attachment",
            json!([
                ["create_time", number(header.create_time)],
                ["data", bytes(&data)],
                ["log_time", number(header.log_time)],
                ["media_type", header.media_type],
                ["name", header.name],
            ]),
        ),
        Record::Metadata(metadata) => {
            ("Metadata", json!([["metadata", metadata.metadata], ["name", metadata.name]]))
        }
        other => return indexes_in_json(&other),
    };
    Some(json!({ "type": kind, "fields": fields }))
}

fn indexes_in_json(record: &Record<'_>) -> Option<Value> {
    let (kind, fields) = match record {
        Record::MessageIndex(_) => return None,
        Record::ChunkIndex(index) => (
            "ChunkIndex",
            json!([
                ["chunk_length", number(index.chunk_length)],
                ["chunk_start_offset", number(index.chunk_start_offset)],
                ["compressed_size", number(index.compressed_size)],
                ["compression", index.compression],
                ["message_end_time", number(index.message_end_time)],
                ["message_index_length", number(index.message_index_length)],
                ["message_index_offsets", counts(&index.message_index_offsets)],
                ["message_start_time", number(index.message_start_time)],
                ["uncompressed_size", number(index.uncompressed_size)],
            ]),
        ),
        Record::AttachmentIndex(index) => (
            "AttachmentIndex",
            json!([
                ["create_time", number(index.create_time)],
                ["data_size", number(index.data_size)],
                ["length", number(index.length)],
                ["log_time", number(index.log_time)],
                ["media_type", index.media_type],
                ["name", index.name],
                ["offset", number(index.offset)],
            ]),
        ),
        Record::Statistics(statistics) => (
            "Statistics",
            json!([
                ["attachment_count", number(statistics.attachment_count)],
                ["channel_count", number(statistics.channel_count)],
                ["channel_message_counts", counts(&statistics.channel_message_counts)],
                ["chunk_count", number(statistics.chunk_count)],
                ["message_count", number(statistics.message_count)],
                ["message_end_time", number(statistics.message_end_time)],
                ["message_start_time", number(statistics.message_start_time)],
                ["metadata_count", number(statistics.metadata_count)],
                ["schema_count", number(statistics.schema_count)],
            ]),
        ),
        Record::MetadataIndex(index) => (
            "MetadataIndex",
            json!([
                ["length", number(index.length)],
                ["name", index.name],
                ["offset", number(index.offset)],
            ]),
        ),
        Record::SummaryOffset(offset) => (
            "SummaryOffset",
            json!([
                ["group_length", number(offset.group_length)],
                ["group_opcode", number(offset.group_opcode)],
                ["group_start", number(offset.group_start)],
            ]),
        ),
        Record::DataEnd(end) => {
            ("DataEnd", json!([["data_section_crc", number(end.data_section_crc)]]))
        }
        other => panic!("no description has opcode {}", other.opcode()),
    };
    Some(json!({ "type": kind, "fields": fields }))
}
