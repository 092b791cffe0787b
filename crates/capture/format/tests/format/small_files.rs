//! A small file costs bounded work and memory, whatever its messages and schemas contain.

use std::collections::BTreeMap as Map;
use std::io::Cursor;

use joulebus_capture_format::inspect::inspect;
use joulebus_capture_format::{DecodeError, Message, MessageKind};
use mcap::records::{MessageHeader, op};

/// Rows that a message may have.
const MAX_ROWS: usize = 1 << 20;

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

/// A file with one message.
fn file() -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut bytes).unwrap();
    let schema = writer.add_schema("p.M", "protobuf", &[]).unwrap();
    let channel_id = writer.add_channel(schema, "/0", "protobuf", &Map::new()).unwrap();
    let header = MessageHeader { channel_id, sequence: 0, log_time: 1, publish_time: 1 };
    writer.write_to_known_channel(&header, &[]).unwrap();
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
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
        let file = with_group(file(), group, start, bytes);
        inspect(Cursor::new(file)).unwrap()
    };
    for group in [op::ATTACHMENT_INDEX, op::METADATA_INDEX] {
        let empty = of(group, 100, 0);
        assert!(empty.is_sound() && empty.complete, "{:?}", empty.findings);
        assert!(!of(group, 100, 9).is_sound());
    }
    assert!(!of(op::STATISTICS, 100, 0).is_sound());
}
