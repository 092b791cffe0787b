//! A capture heals: what a flipped bit or a lost beginning costs.

use std::collections::BTreeSet;
use std::io::Cursor;

use joulebus_capture_format::recover::recover;
use joulebus_capture_format::scan::{Event, Scan};
use joulebus_capture_format::{
    Attachments, CaptureSettings, Message, Preset, Reader, Times, Writer,
};
use joulebus_wire::{Forecasts, Outlooks, Sample, SampleHeader, Samples};
use mcap::records::op;

/// Messages in a chunk of 50 ms.
const IN_CHUNK: u64 = 10;
/// Chunks of a capture, two of them after its first minute.
const CHUNKS: u64 = 5;

/// A capture of two channels, with a third from the second chunk on. One that was `killed` has no
/// end.
fn capture(preset: Preset, killed: bool) -> Vec<u8> {
    let mut attachments = Attachments::default();
    attachments.describe("format", "1".to_owned());
    attachments.add_fleet("lab", "[fleet]\nname = \"lab\"\n".to_owned(), Vec::new());
    let settings = CaptureSettings { chunk_ns: 50_000_000, ..CaptureSettings::new(preset) };
    let mut writer = Writer::new(Vec::new(), settings, &attachments).unwrap();
    for chunk in 0..CHUNKS {
        let from_ns = chunk * 50_000_000 + u64::from(chunk > 2) * 60_000_000_000;
        for number in 0..IN_CHUNK {
            let message = match number % 3 {
                0 => {
                    let sample = Sample::new(7, number, from_ns).reading(4.2, from_ns);
                    Message::of::<Samples>(SampleHeader::default(), vec![sample])
                }
                1 => Message::of::<Forecasts>(Default::default(), Vec::new()),
                _ if chunk == 0 => Message::of::<Forecasts>(Default::default(), Vec::new()),
                _ => Message::of::<Outlooks>(Default::default(), Vec::new()),
            };
            let times = Times { log_ns: from_ns + number, publish_ns: from_ns };
            writer.write("lab", times, &message).unwrap();
        }
    }
    let (_, _, mut file) = writer.finish().unwrap();
    if killed {
        let end = records(&file).into_iter().find(|(opcode, ..)| *opcode == op::DATA_END);
        file.truncate(end.unwrap().1);
    }
    file
}

/// Opcode, offset and length of the records outside of chunks, and of the chunks.
fn records(file: &[u8]) -> Vec<(u8, usize, usize)> {
    let mut scan = Scan::new(Cursor::new(file)).unwrap();
    let mut found = Vec::new();
    while let Ok(Some(event)) = scan.next_event() {
        match event {
            Event::ChunkBegins(frame) => found.push((op::CHUNK, frame.offset, frame.bytes)),
            Event::Record(raw) if raw.place.in_chunk.is_none() => {
                found.push((raw.opcode, raw.place.offset, 9 + raw.body.len() as u64));
            }
            _ => {}
        }
    }
    let record = |(opcode, at, bytes)| {
        (opcode, usize::try_from(at).unwrap(), usize::try_from(bytes).unwrap())
    };
    found.into_iter().map(record).collect()
}

/// Messages of topics that the capture had, in what is recovered of `file`.
fn recovered(file: &[u8], what: &str) -> u64 {
    let (recovery, healed) = match recover(Cursor::new(file), Cursor::new(Vec::new())) {
        Ok(done) => done,
        Err(error) => panic!("{what}: {error}"),
    };
    let known = ["samples", "forecasts", "outlooks"];
    let healed = healed.into_inner();
    let reader = Reader::new(Cursor::new(&healed)).unwrap();
    assert!(!reader.attachments().metadata.contains_key("joulebus.channels"), "{what}");
    let topics = recovery.topics.iter();
    let known = topics
        .filter(|(topic, _)| known.iter().any(|name| **topic == format!("joulebus/lab/{name}")));
    known.map(|(_, messages)| messages).sum()
}

#[test]
fn a_flipped_byte_of_any_record_loses_at_most_its_chunk() {
    for (preset, killed) in
        [(Preset::ZstdFast, true), (Preset::FastWrite, true), (Preset::ZstdFast, false)]
    {
        let whole = capture(preset, killed);
        assert_eq!(recovered(&whole, "whole"), CHUNKS * IN_CHUNK);
        let records = records(&whole);
        let kinds: BTreeSet<u8> = records.iter().map(|(opcode, ..)| *opcode).collect();
        assert!(kinds.len() >= if killed { 5 } else { 10 }, "{kinds:?}");
        for (opcode, at, bytes) in records {
            // Each byte of a head and of what follows it, and a share of long contents.
            for byte in (at..at + bytes).filter(|byte| byte - at < 32 || byte % 61 == 0) {
                let flip = if byte % 2 == 0 { 0x10 } else { 0x81 };
                let mut file = whole.clone();
                file[byte] ^= flip;
                let what =
                    format!("{preset:?} {killed} opcode {opcode:#04x} at {at}, byte {}", byte - at);
                let found = recovered(&file, &what);
                assert!(found >= (CHUNKS - 1) * IN_CHUNK, "{what}: {found} messages");
            }
        }
    }
}

#[test]
fn what_is_recovered_is_compressed_as_it_was() {
    let whole = capture(Preset::ZstdFast, true);
    let (_, healed) = recover(Cursor::new(&whole), Cursor::new(Vec::new())).unwrap();
    let mut scan = Scan::new(healed).unwrap();
    let mut compressions = BTreeSet::new();
    while let Some(event) = scan.next_event().unwrap() {
        if let Event::ChunkBegins(frame) = event {
            compressions.insert(frame.header.compression);
        }
    }
    assert_eq!(compressions, BTreeSet::from(["zstd".to_owned()]));
}

#[test]
fn a_capture_without_its_beginning_keeps_what_follows() {
    for (preset, killed) in
        [(Preset::ZstdFast, true), (Preset::FastWrite, true), (Preset::ZstdFast, false)]
    {
        let whole = capture(preset, killed);
        let chunks: Vec<_> =
            records(&whole).into_iter().filter(|(opcode, ..)| *opcode == op::CHUNK).collect();
        for (lost, (_, at, bytes)) in chunks.iter().enumerate() {
            let left = CHUNKS - 1 - lost as u64;
            // All channels were told after the third chunk, and would be after another minute.
            if left == 0 || (killed && lost > 2) {
                continue;
            }
            let from = at + bytes / 2;
            let found = recovered(
                &whole[from..],
                &format!("{preset:?} {killed} {lost}, from {from} of {}", whole.len()),
            );
            assert!(found >= left * IN_CHUNK, "{preset:?} {killed} without {from} bytes: {found}");
        }
    }
}
