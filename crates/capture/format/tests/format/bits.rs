//! Payloads are restored from a capture with the same bits, and match the schema.

use std::io::Cursor;

use joulebus_capture_format::{
    Attachments, CaptureSettings, Message, MessageKind, Preset, Reader, Times, Writer,
};
use proptest::prelude::*;
use prost_reflect::{DescriptorPool, DynamicMessage, ReflectMessage as _, Value};

use crate::fields::{self, Bits, Fields, assert_same_bits, messages};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn every_message_round_trips_bit_for_bit(seed: u64) {
        for message in messages(&mut Bits(seed)) {
            let mut data = Vec::new();
            message.encode(&mut data);
            let read = Message::decode(message.kind().unwrap(), &data).unwrap();
            assert_same_bits(&read, &message);
        }
    }

    #[test]
    fn the_decoder_never_panics(kind in 0..MessageKind::ALL.len(), data: Vec<u8>) {
        let _ = Message::decode(MessageKind::ALL[kind], &data);
    }

    #[test]
    fn the_schema_names_every_field_and_its_value(seed: u64) {
        let mut bits = Bits(seed);
        let (sample, forecast) = (fields::sample(&mut bits), fields::forecast(&mut bits));
        let (diagnostic, budget) = (fields::diagnostic(&mut bits), fields::budget(&mut bits));
        let (samples, budgets) = (fields::sample_header(&mut bits), fields::budget_header(&mut bits));
        let (ticks, state) = (fields::tick_header(&mut bits), fields::state_header(&mut bits));
        for (message, expected) in [
            (Message::RobotSample(sample), fields::sample_fields(&sample)),
            (Message::RobotForecast(forecast), fields::forecast_fields(&forecast)),
            (Message::RobotDiagnostic(diagnostic), fields::diagnostic_fields(&diagnostic)),
            (Message::RobotBudget(budget), fields::budget_fields(&budget)),
            (Message::Samples(samples, vec![]), fields::sample_header_fields(&samples)),
            (Message::Budgets(budgets, vec![]), fields::budget_header_fields(&budgets)),
            (Message::Ticks(ticks, vec![]), fields::tick_header_fields(&ticks)),
            (Message::State(state, vec![]), fields::state_header_fields(&state)),
        ] {
            assert_described(&message, &expected);
        }
    }
}

/// The message, decoded by its schema only, has these fields and no others.
fn dynamic(message: &Message) -> DynamicMessage {
    let kind = message.kind().unwrap();
    let pool = DescriptorPool::decode(kind.descriptors().as_slice()).unwrap();
    let descriptor = pool.get_message_by_name(kind.schema()).unwrap();
    let mut data = Vec::new();
    message.encode(&mut data);
    let read = DynamicMessage::decode(descriptor, data.as_slice()).unwrap();
    assert_eq!(read.unknown_fields().count(), 0, "{}", kind.schema());
    read
}

fn assert_described(message: &Message, expected: &Fields) {
    let read = dynamic(message);
    for (name, bits) in expected {
        let found = match *name {
            "sent_unix_ns" => nanoseconds(&read.get_field_by_name("sent_at").unwrap()),
            name => number(&read.get_field_by_name(name).unwrap()),
        };
        assert_eq!(found, *bits, "{name} of {message:?}");
    }
    // In addition, only the rows.
    let described = read.descriptor().fields().count();
    let rows = usize::from(message.robot().is_none());
    assert_eq!(described, expected.len() + rows, "{message:?}");
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
fn rows_and_counts_are_described_as_well() {
    let mut bits = Bits(7);
    for _ in 0..50 {
        let header = fields::forecast_header(&mut bits);
        let rows: Vec<_> = (0..3).map(|_| fields::forecast(&mut bits)).collect();
        let read = dynamic(&Message::Forecasts(header, rows.clone()));
        let dropped = read.get_field_by_name("samples_dropped").unwrap();
        let backlog = dropped.as_message().unwrap().get_field_by_name("backlog");
        let reason = joulebus_wire::DropReason::Backlog;
        assert_eq!(
            number(&backlog.unwrap()),
            header.samples_dropped.get(reason)
        );
        let forecasts = read.get_field_by_name("forecasts").unwrap();
        let forecasts = forecasts.as_list().unwrap();
        assert_eq!(forecasts.len(), 3);
        for (found, row) in forecasts.iter().zip(&rows) {
            let power = found.as_message().unwrap().get_field_by_name("power_w");
            assert_eq!(number(&power.unwrap()), u64::from(row.power_w.to_bits()));
        }
    }
}

#[test]
fn codes_have_names_in_the_schema() {
    let pool = DescriptorPool::decode(MessageKind::Diagnostics.descriptors().as_slice()).unwrap();
    let alarms = pool.get_enum_by_name("joulebus.Alarm").unwrap();
    for alarm in joulebus_wire::Alarm::ALL {
        let value = alarms.get_value(i32::from(alarm.code())).unwrap();
        let plain = value.name().replace('_', "");
        let expected = format!("ALARM{}", alarm.name().to_uppercase());
        assert_eq!(plain, expected);
    }
    let reasons = pool.get_enum_by_name("joulebus.DropReason").unwrap();
    for (place, reason) in joulebus_wire::DropReason::ALL.into_iter().enumerate() {
        let value = reasons.get_value(place as i32 + 1).unwrap();
        let expected = format!("DROPREASON{}", reason.name().to_uppercase());
        assert_eq!(value.name().replace('_', ""), expected);
    }
}

#[test]
fn a_file_round_trips_in_every_preset() {
    for preset in Preset::ALL {
        let mut bits = Bits(preset as u64);
        let written: Vec<Message> = (0..40).flat_map(|_| messages(&mut bits)).collect();
        let mut attachments = Attachments::default();
        attachments.add(
            "lab/config.toml".to_owned(),
            "application/toml",
            b"x = 1".to_vec(),
        );
        let mut writer =
            Writer::new(Vec::new(), CaptureSettings::of(preset), &attachments).unwrap();
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
            assert_same_bits(&entry.message, message);
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
