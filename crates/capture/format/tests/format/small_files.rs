//! A small file costs bounded work and memory, whatever its messages and schemas contain.

use std::collections::BTreeMap as Map;
use std::io::Cursor;

use joulebus_capture_format::inspect::inspect;
use joulebus_capture_format::scan::ScanError;
use joulebus_capture_format::values::{Line, Passed, values};
use joulebus_capture_format::{DecodeError, Message, MessageKind};
use mcap::records::{MessageHeader, op};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

/// Rows that a message may have.
const MAX_ROWS: usize = 1 << 20;

/// Descriptors of a message with `count` fields of its own type, and one of numbers.
fn recursive(count: i32) -> Vec<u8> {
    let field = |number: i32, kind: Type, label: Label| FieldDescriptorProto {
        name: Some(format!("f{number}")),
        number: Some(number),
        r#type: Some(kind.into()),
        label: Some(label.into()),
        type_name: (kind == Type::Message).then(|| ".p.M".to_owned()),
        ..FieldDescriptorProto::default()
    };
    let mut fields: Vec<_> =
        (1..=count).map(|number| field(number, Type::Message, Label::Repeated)).collect();
    fields.push(field(count + 1, Type::Uint32, Label::Repeated));
    let file = FileDescriptorProto {
        name: Some("p.proto".to_owned()),
        package: Some("p".to_owned()),
        syntax: Some("proto3".to_owned()),
        message_type: vec![DescriptorProto {
            name: Some("M".to_owned()),
            field: fields,
            ..DescriptorProto::default()
        }],
        ..FileDescriptorProto::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}

/// A file with `channels` of one schema, and one message in each.
fn file(schema: &[u8], channels: u16, data: &[u8]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut bytes).unwrap();
    let schema = writer.add_schema("p.M", "protobuf", schema).unwrap();
    for number in 0..channels {
        let topic = format!("/{number}");
        let channel = writer.add_channel(schema, &topic, "protobuf", &Map::new());
        let header = MessageHeader {
            channel_id: channel.unwrap(),
            sequence: 0,
            log_time: 1,
            publish_time: 1,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

fn passed(file: Vec<u8>) -> Passed {
    let take = |_: Line<'_>| Ok::<(), ScanError>(());
    values(Cursor::new(file), |_| true, take).unwrap()
}

#[test]
fn a_message_that_contains_itself_has_bounded_columns() {
    // Eight levels of 40 fields have ten billion.
    assert_eq!(passed(file(&recursive(40), 1, &[])).undecoded.len(), 0);
    let mut bytes = 0;
    let add = |line: Line<'_>| {
        bytes += line.columns.iter().map(String::len).sum::<usize>();
        Ok::<(), ScanError>(())
    };
    values(Cursor::new(file(&recursive(40), 1, &[])), |_| true, add).unwrap();
    assert!((1..=1 << 20).contains(&bytes), "{bytes}");
}

#[test]
fn what_would_take_hundreds_of_times_its_length_in_memory_is_not_decoded() {
    let many = [0x0a, 0x00].repeat(1_000_000);
    let mut numbers = vec![0x12];
    prost::encoding::encode_varint(9_000_000, &mut numbers);
    numbers.resize(numbers.len() + 9_000_000, 1);
    let mut deep = Vec::new();
    for _ in 0..200 {
        let mut outer = vec![0x0a];
        prost::encoding::encode_varint(deep.len() as u64, &mut outer);
        outer.extend(deep);
        deep = outer;
    }
    for (what, data) in [("messages", many), ("numbers", numbers), ("levels", deep)] {
        let passed = passed(file(&recursive(1), 1, &data));
        assert_eq!(passed.undecoded.values().sum::<u64>(), 1, "{what}");
    }
    let few = [0x0a, 0x00, 0x10, 0x07].repeat(1_000);
    assert!(passed(file(&recursive(1), 1, &few)).undecoded.is_empty());
}

#[test]
fn channels_share_the_descriptors_of_their_schema() {
    let mut shared = Vec::new();
    let keep = |line: Line<'_>| {
        shared.push(line.columns.as_ptr());
        Ok::<(), ScanError>(())
    };
    values(Cursor::new(file(&recursive(3), 2, &[])), |_| true, keep).unwrap();
    assert_eq!(shared[0], shared[1]);
    let passed = passed(file(&recursive(3), 5_000, &[]));
    assert_eq!((passed.messages, passed.undecoded.len()), (5_000, 0));
}

#[test]
fn no_message_of_empty_rows_is_decoded_that_has_more_than_a_fleet_has_robots() {
    for kind in MessageKind::all() {
        for number in [1_u8, 5, 16, 20, 30] {
            let tag = u16::from(number) << 3 | 2;
            let empty = match u8::try_from(tag) {
                Ok(tag) if tag < 0x80 => vec![tag, 0],
                _ => vec![(tag & 0x7f) as u8 | 0x80, (tag >> 7) as u8, 0],
            };
            let rows = empty.repeat(MAX_ROWS + 1);
            let is_refused = |data: &[u8]| {
                matches!(
                    Message::decode(kind, data),
                    Err(DecodeError::TooManyRows { found }) if found > MAX_ROWS
                )
            };
            assert!(is_refused(&rows), "{kind:?}, {number}");
            // In the answer of a question.
            if kind == MessageKind::of::<joulebus_wire::Queries>() {
                let mut answer = empty[..empty.len() - 1].to_vec();
                prost::encoding::encode_varint(rows.len() as u64, &mut answer);
                answer.extend(&rows);
                assert!(is_refused(&answer), "{number}");
            }
        }
    }
}

/// The file with a summary offset of a group that starts at `start` and has `bytes`, and without
/// checksum of its summary.
fn with_group(mut file: Vec<u8>, group: u8, start: u64, bytes: u64) -> Vec<u8> {
    let mut offset = vec![op::SUMMARY_OFFSET];
    offset.extend(17_u64.to_le_bytes());
    offset.push(group);
    offset.extend(start.to_le_bytes());
    offset.extend(bytes.to_le_bytes());
    let end = file.len();
    // The footer is 29 bytes; its checksum and the magic bytes end the file.
    file[end - 12..end - 8].fill(0);
    file.splice(end - 37..end - 37, offset);
    file
}

#[test]
fn groups_of_the_summary_without_records_are_no_fault_and_those_that_lack_some_are() {
    let of = |group, start, bytes| {
        let file = with_group(file(&recursive(1), 1, &[]), group, start, bytes);
        inspect(Cursor::new(file)).unwrap()
    };
    for group in [op::ATTACHMENT_INDEX, op::METADATA_INDEX] {
        let empty = of(group, 100, 0);
        assert!(empty.is_sound() && empty.complete, "{:?}", empty.findings);
        assert!(!of(group, 100, 9).is_sound());
    }
    assert!(!of(op::STATISTICS, 100, 0).is_sound());
}
