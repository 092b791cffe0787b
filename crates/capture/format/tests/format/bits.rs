//! Payloads are restored from a capture with the same bits, and match the schema.

use std::io::Cursor;

use joulebus_capture_format::{
    Attachments, CaptureSettings, DecodeError, Message, MessageKind, Preset, Reader, Times, Writer,
};
use joulebus_wire::{
    AnswerHeader, AnswerRow, Channel, DropReason, FieldType, ForEachChannel, Forecasts, Queries,
    QueryHeader, Refusal, Row, each_channel,
};
use proptest::prelude::*;
use prost_reflect::{DescriptorPool, DynamicMessage, ReflectMessage as _, Value};

use crate::fields::{Bits, messages};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn every_message_round_trips_bit_for_bit(seed: u64) {
        for message in messages(&mut Bits(seed)) {
            let mut data = Vec::new();
            message.encode(&mut data);
            let read = Message::decode(message.kind().unwrap(), &data).unwrap();
            assert_eq!(read, message);
        }
    }

    #[test]
    fn the_decoder_never_panics(kind in 0..MessageKind::all().count(), data: Vec<u8>) {
        let _ = Message::decode(MessageKind::all().nth(kind).unwrap(), &data);
    }

    #[test]
    fn the_schema_names_every_field_and_its_value(seed: u64) {
        each_channel(&mut Described(Bits(seed)));
    }

    #[test]
    fn what_another_decoder_accepts_is_accepted_and_nothing_else(seed: u64) {
        let mut bits = Bits(seed);
        for message in messages(&mut bits) {
            let mut data = Vec::new();
            message.encode(&mut data);
            for _ in 0..1 + bits.u64() % 3 {
                let at = (bits.u64() % (data.len() as u64 + 1)) as usize;
                match bits.u64() % 5 {
                    0 => data.truncate(at),
                    1 => data.insert(at, bits.u64() as u8),
                    2 if at < data.len() => data[at] ^= 1 << (bits.u64() % 8),
                    3 => message.encode(&mut data),
                    // A field that is not known; of a group.
                    _ => data.extend([0xfb, 0x07, 0x0a, 0x01, bits.u64() as u8, 0xfc, 0x07]),
                }
            }
            let kind = message.kind().unwrap();
            let found = Message::decode(kind, &data);
            match DynamicMessage::decode(descriptor(kind), data.as_slice()) {
                Ok(_) => prop_assert!(!matches!(found, Err(DecodeError::Protobuf { .. })), "{data:?}: {found:?}"),
                Err(error) => prop_assert!(matches!(found, Err(DecodeError::Protobuf { .. })), "{data:?}: {error}"),
            }
        }
    }
}

fn descriptor(kind: MessageKind) -> prost_reflect::MessageDescriptor {
    thread_local! {
        static POOLS: std::cell::RefCell<std::collections::HashMap<MessageKind, DescriptorPool>> =
            std::cell::RefCell::default();
    }
    let pool = POOLS.with_borrow_mut(|pools| {
        let decode = || DescriptorPool::decode(kind.descriptors().as_slice()).unwrap();
        pools.entry(kind).or_insert_with(decode).clone()
    });
    pool.get_message_by_name(&kind.schema()).unwrap()
}

/// The message, decoded by its schema only, has these fields and no others.
pub(crate) fn dynamic(kind: MessageKind, data: &[u8]) -> DynamicMessage {
    let read = DynamicMessage::decode(descriptor(kind), data).unwrap();
    assert_eq!(read.unknown_fields().count(), 0, "{}", kind.schema());
    read
}

/// Compares messages of arbitrary bits of each channel with their schemas.
struct Described(Bits);

impl ForEachChannel for Described {
    fn channel<C: Channel>(&mut self) {
        let (kind, mut data) = (MessageKind::of::<C>(), Vec::new());
        if kind == MessageKind::of::<Queries>() {
            let query = self.0.query();
            Message::from(query.clone()).encode(&mut data);
            return assert_query(&query, &dynamic(kind, &data));
        }
        let message = Message::of::<C>(self.0.row(), self.0.rows(Bits::row));
        message.encode(&mut data);
        assert_described::<C>(&message, &dynamic(kind, &data));
        if kind.has_robots() {
            let row: C::Row = self.0.row();
            Message::of::<C>(C::Header::default(), vec![row]).each_robot(|message| {
                data.clear();
                message.encode(&mut data);
                let read = dynamic(message.kind().unwrap(), &data);
                let described = read.descriptor().fields().count();
                assert_eq!(described, assert_fields(&row, &read, &[]));
            });
        }
    }
}

/// Fails unless the message by its schema has the bits of the frame, and nothing else.
pub(crate) fn assert_described<C: Channel>(message: &Message, read: &DynamicMessage) {
    let frame = message.frame::<C>().unwrap();
    let described = read.descriptor().fields().count();
    // In addition, only the rows.
    assert_eq!(described, assert_fields(&frame.header, read, &[]) + 1);
    let rows = read.descriptor().fields().max_by_key(|field| field.number());
    match &*read.get_field(&rows.unwrap()) {
        Value::Bytes(bytes) => assert_eq!(**bytes, *bytemuck::cast_slice::<_, u8>(&frame.rows)),
        rows => assert_rows(&frame.rows, rows),
    }
}

fn assert_rows<T: Row>(rows: &[T], read: &Value) {
    let read = read.as_list().unwrap();
    assert_eq!(read.len(), rows.len());
    for (row, read) in rows.iter().zip(read) {
        let read = read.as_message().unwrap();
        let described = read.descriptor().fields().count();
        assert_eq!(described, assert_fields(row, read, &[]), "{row:?}");
    }
}

/// Compares the fields of a struct, except `others`; returns their number.
fn assert_fields<T: Row>(row: &T, read: &DynamicMessage, others: &[&str]) -> usize {
    let bytes = bytemuck::bytes_of(row);
    let fields = T::LAYOUT.fields.iter().filter(|field| !others.contains(&field.name));
    let each = fields.map(|field| {
        let bytes = &bytes[field.offset..][..field.size];
        let of = read.get_field_by_name(field.name);
        let found = match (field.of, field.elements) {
            _ if field.name == "sent_unix_ns" && of.is_none() => {
                vec![nanoseconds(&read.get_field_by_name("sent_at").unwrap())]
            }
            (FieldType::Struct("DropCounts"), None) => counts(&of.unwrap()),
            (FieldType::Struct("Refusal"), Some(_)) => {
                let of = of.unwrap();
                let list = of.as_list().unwrap();
                for (read, bytes) in list.iter().zip(bytes.chunks(size_of::<Refusal>())) {
                    let refusal: Refusal = bytemuck::pod_read_unaligned(bytes);
                    assert_eq!(assert_fields(&refusal, read.as_message().unwrap(), &[]), 4);
                }
                let written = list.len() * size_of::<Refusal>();
                assert!(bytes[written..].iter().all(|byte| *byte == 0));
                return;
            }
            (FieldType::U8, _) => {
                let of = of.unwrap();
                return assert_eq!(of.as_str(), Some(joulebus_wire::text(bytes)));
            }
            (_, None) => vec![number(&of.unwrap())],
            (_, Some(_)) => of.unwrap().as_list().unwrap().iter().map(number).collect(),
        };
        let mut expected = numbers(field.of, bytes);
        // Zeros at the end are not written.
        assert!(expected.split_off(found.len()).iter().all(|bits| *bits == 0));
        assert_eq!(found, expected, "{}.{}", T::LAYOUT.name, field.name);
    });
    each.count()
}

/// The bits of numbers in shared memory.
fn numbers(of: FieldType, bytes: &[u8]) -> Vec<u64> {
    let size = match of {
        FieldType::U16 => 2,
        FieldType::U32 | FieldType::F32 => 4,
        _ => 8,
    };
    let number = |bytes: &[u8]| {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(word)
    };
    bytes.chunks(size).map(number).collect()
}

/// By the names of the reasons, in their order; then those of later versions.
fn counts(read: &Value) -> Vec<u64> {
    let read = read.as_message().unwrap();
    let named = DropReason::ALL.into_iter().map(|reason| {
        let plain = |name: &str| name.replace('_', "").eq_ignore_ascii_case(reason.name());
        let field = read.descriptor().fields().find(|field| plain(field.name()));
        number(&read.get_field(&field.unwrap()))
    });
    let later = read.get_field_by_name("later").unwrap();
    let later = later.as_list().unwrap().iter().map(number);
    named.chain(later).collect()
}

pub(crate) fn assert_query(query: &joulebus_capture_format::Query, read: &DynamicMessage) {
    let in_parts = ["values", "words", "reserved", "query", "answer"];
    assert_eq!(assert_fields(&query.record, read, &in_parts), 3);
    let part = |name| read.get_field_by_name(name).unwrap().into_owned();
    let (question, answer) = (part("question"), part("answer"));
    let (question, answer) = (question.as_message().unwrap(), answer.as_message().unwrap());
    let fields = QueryHeader::LAYOUT.fields.len();
    assert_eq!(assert_fields(&query.record.query, question, &[]), fields);
    let lengths = ["rows", "powers", "text_bytes"];
    let fields = AnswerHeader::LAYOUT.fields.len();
    assert_eq!(assert_fields(&query.record.answer, answer, &lengths), fields - 3);
    let list = |of: &DynamicMessage, name: &str| -> Vec<u64> {
        let list = of.get_field_by_name(name).unwrap();
        list.as_list().unwrap().iter().map(number).collect()
    };
    let values: Vec<u64> = query.values.iter().map(|value| value.to_bits()).collect();
    assert_eq!(list(question, "values"), values);
    let power_w = query.power_w.iter().map(|power_w| power_w.to_bits().into());
    assert_eq!(list(answer, "power_w"), power_w.collect::<Vec<u64>>());
    assert_rows::<AnswerRow>(&query.rows, &answer.get_field_by_name("rows").unwrap());
    assert_eq!(answer.get_field_by_name("text").unwrap().as_str(), Some(&*query.text));
}

fn number(value: &Value) -> u64 {
    match value {
        Value::U32(value) => u64::from(*value),
        Value::U64(value) => *value,
        Value::I64(value) => *value as u64,
        Value::F32(value) => u64::from(value.to_bits()),
        Value::F64(value) => value.to_bits(),
        // Codes of 32 bits are kept.
        Value::EnumNumber(value) => u64::from(*value as u32),
        value => panic!("{value:?} is not a number"),
    }
}

fn nanoseconds(value: &Value) -> u64 {
    let time = value.as_message().unwrap();
    let part = |name| time.get_field_by_name(name).unwrap().into_owned();
    let seconds = part("seconds").as_i64().unwrap() as u64;
    seconds * 1_000_000_000 + part("nanos").as_i32().unwrap() as u64
}

#[test]
fn values_that_another_program_omits_are_nan_and_numbers_that_exceed_their_fields_are_named() {
    let kind = MessageKind::of::<Forecasts>();
    let row = [0xf2, 0x01, 0x02, 0x08, 0x07];
    let read = Message::decode(kind, &row).unwrap();
    let frame = read.frame::<Forecasts>().unwrap();
    assert_eq!(frame.rows[0].robot, 7);
    assert!(frame.rows[0].power_w.is_nan() && frame.rows[0].quality == 0);
    // The last one counts.
    for (qualities, error_text) in [
        (&[0x18, 0x80, 0x80, 0x04, 0x18, 0x02][..], None),
        (
            &[0x18, 0x02, 0x18, 0x80, 0x80, 0x04],
            Some("Forecast.quality = 65536: allowed are 0 to 65535"),
        ),
        (
            &[0x20, 0xff, 0xff, 0xff, 0xff, 0x0f],
            Some("Forecast.quality_detail = 4294967295: allowed are 0 to 65535"),
        ),
    ] {
        let row = [&[0xf2, 0x01, qualities.len() as u8], qualities].concat();
        let refusal_now = Message::decode(kind, &row).err().map(|error| error.to_string());
        assert_eq!(refusal_now.as_deref(), error_text);
    }
    // Before 1970.
    let time = [
        0x7a, 0x02, 0x08, 0x7f, 0x7a, 0x0b, 0x08, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
        0xff, 0x01,
    ];
    let error_text = Message::decode(kind, &time).unwrap_err().to_string();
    assert_eq!(
        error_text,
        format!("Forecasts.sent_at = -1000000000: allowed are 0 to {}", u64::MAX)
    );
    let error_text =
        Message::decode(kind, &[0xf2, 0x01, 0x03, 0x2d, 1, 2]).unwrap_err().to_string();
    assert_eq!(
        error_text,
        "failed to decode Protobuf message: Forecast.reading_w: buffer underflow"
    );
}

#[test]
fn codes_have_names_in_the_schema() {
    let kind = MessageKind::of::<joulebus_wire::Diagnostics>();
    let pool = DescriptorPool::decode(kind.descriptors().as_slice()).unwrap();
    let alarms = pool.get_enum_by_name("joulebus.Alarm").unwrap();
    for alarm in joulebus_wire::Alarm::ALL {
        let value = alarms.get_value(i32::from(alarm.code())).unwrap();
        let plain = value.name().replace('_', "");
        let expected = format!("ALARM{}", alarm.name().to_uppercase());
        assert_eq!(plain, expected);
    }
    let reasons = pool.get_enum_by_name("joulebus.DropReason").unwrap();
    for (place, reason) in DropReason::ALL.into_iter().enumerate() {
        let value = reasons.get_value(place as i32 + 1).unwrap();
        let expected = format!("DROPREASON{}", reason.name().to_uppercase());
        assert_eq!(value.name().replace('_', ""), expected);
    }
}

#[test]
fn a_changed_description_shows_as_altered() {
    use joulebus_capture_format::Clock;
    let begun = Attachments::begun(5, Clock { offset_ns: 3 }, "boot".to_owned());
    let settings = CaptureSettings::new(Preset::ALL[0]);
    let (_, _, file) = Writer::new(Vec::new(), settings, &begun).unwrap().finish().unwrap();
    let mut attachments = Reader::new(Cursor::new(&file)).unwrap().attachments().clone();
    assert_eq!(attachments.altered(), Vec::<&str>::new());
    attachments.describe("answer_rules", "3".to_owned());
    assert_eq!(attachments.altered(), ["joulebus"]);
}

#[test]
fn a_file_round_trips_in_every_preset() {
    for preset in Preset::ALL {
        let mut bits = Bits(preset as u64);
        let written: Vec<Message> = (0..40).flat_map(|_| messages(&mut bits)).collect();
        let mut attachments = Attachments::default();
        attachments.add("lab/config.toml".to_owned(), "application/toml", b"x = 1".to_vec());
        let mut writer =
            Writer::new(Vec::new(), CaptureSettings::new(preset), &attachments).unwrap();
        for (number, message) in written.iter().enumerate() {
            let times = Times {
                log_ns: 1_000_000_000 + number as u64 * 7_000_000,
                publish_ns: number as u64,
            };
            writer.write("lab", times, message).unwrap();
        }
        let (counted, _, file) = writer.finish().unwrap();
        assert_eq!(counted.messages, written.len() as u64);
        assert_eq!(counted.bytes, file.len() as u64);
        let mut reader = Reader::new(Cursor::new(&file)).unwrap();
        assert_eq!(reader.attachments().config("lab"), Some("x = 1"));
        assert_eq!(reader.attachments().altered(), Vec::<&str>::new());
        let mut next = std::collections::HashMap::new();
        for (number, message) in written.iter().enumerate() {
            let entry = reader.next_entry().unwrap().unwrap();
            assert_eq!(&entry.message, message);
            assert_eq!(&*entry.fleet, "lab");
            let robot = message.robot().unwrap_or(0);
            assert_eq!(*entry.topic, message.kind().unwrap().topic("lab", robot));
            assert_eq!(entry.log_time_ns, 1_000_000_000 + number as u64 * 7_000_000);
            assert_eq!(entry.publish_time_ns, number as u64);
            let sequence = next.entry(entry.topic.to_string()).or_insert(0);
            assert_eq!(entry.sequence, *sequence);
            *sequence += 1;
        }
        assert!(reader.next_entry().unwrap().is_none());
        // Data for other programs: statistics, an index of every chunk, valid CRCs.
        let summary = mcap::Summary::read(&file).unwrap().unwrap();
        let stats = summary.stats.unwrap();
        assert_eq!(stats.message_count, counted.messages);
        assert_eq!(stats.attachment_count, 1);
        assert!(stats.chunk_count > 1, "{preset:?}");
        assert_eq!(summary.chunk_indexes.len(), stats.chunk_count as usize);
    }
}
