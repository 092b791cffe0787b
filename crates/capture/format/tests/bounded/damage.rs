//! Corrupt files: truncated at every byte, every byte changed. No panic, bounded allocation, every
//! error names its location, and recovered and lost records add up.

use std::collections::BTreeMap;
use std::io::Cursor;

use joulebus_capture_format::inspect::{Severity, inspect};
use joulebus_capture_format::recover::recover;
use joulebus_capture_format::scan::{Event, Scan};
use joulebus_capture_format::{ReadError, Reader};
use joulebus_testkit::counting;
use mcap::records::{Record, op};

use crate::damaged::{KINDS, MESSAGES, file, read, recovered};

/// Buffers of one scan, one decompressor and one writer; wrong lengths must not add to it.
const MAX_BYTES: u64 = 24 << 20;

#[test]
fn a_valid_file_is_recovered_completely() {
    for kind in KINDS {
        let recovery = recovered(&file(kind), kind.name).unwrap();
        assert!(recovery.is_clean(), "{}: {recovery}", kind.name);
        assert_eq!(recovery.messages.recovered, MESSAGES, "{}", kind.name);
        let b = MESSAGES.div_ceil(3);
        let topics = BTreeMap::from([("a".to_owned(), MESSAGES - b), ("b".to_owned(), b)]);
        assert_eq!(recovery.topics, topics);
    }
}

/// End offset of each message in the file; for uncompressed files only.
fn message_ends(bytes: &[u8]) -> Vec<u64> {
    let mut scan = Scan::new(Cursor::new(bytes)).unwrap();
    let mut ends = Vec::new();
    let mut records_at = 0;
    while let Some(event) = scan.next_event().unwrap() {
        match event {
            // Its head: opcode, length, five numbers and an empty name.
            Event::ChunkBegins(frame) => records_at = frame.offset + 49,
            Event::Record(raw) if raw.opcode == op::MESSAGE => {
                let start = match raw.place.in_chunk {
                    Some(inner) => records_at + inner,
                    None => raw.place.offset,
                };
                ends.push(start + 9 + raw.body.len() as u64);
            }
            _ => {}
        }
    }
    ends
}

#[test]
fn truncated_anywhere_every_message_before_the_end_is_recovered() {
    for kind in KINDS {
        let whole = file(kind);
        let ends = message_ends(&whole);
        let mut cuts_with_loss = 0;
        for cut in 0..whole.len() {
            let what = format!("{} cut at {cut} of {}", kind.name, whole.len());
            let found = inspect(Cursor::new(&whole[..cut]));
            if cut < 8 {
                assert!(found.unwrap_err().to_string().contains("byte 0"), "{what}");
                assert!(recovered(&whole[..cut], &what).is_none());
                continue;
            }
            let found = found.unwrap();
            assert!(!found.complete && !found.is_sound(), "{what}");
            let place = found.findings.iter().find(|finding| finding.severity == Severity::Error);
            let place = place.unwrap().place.unwrap();
            assert!(place.offset <= cut as u64, "{what}: {place}");
            assert!(read(&whole[..cut]) <= MESSAGES, "{what}");
            let recovery = recovered(&whole[..cut], &what).unwrap();
            assert!(!recovery.is_clean(), "{what}");
            let messages = recovery.messages;
            if kind.compression.is_none() {
                let before = ends.iter().filter(|end| **end <= cut as u64).count() as u64;
                assert_eq!(messages.recovered, before, "{what}");
            }
            assert!(messages.recovered <= MESSAGES, "{what}");
            assert!(
                recovery.lost_unknown || messages.recovered + messages.lost == MESSAGES,
                "{what}: {recovery}"
            );
            cuts_with_loss += u64::from(messages.recovered < MESSAGES);
        }
        println!(
            "figure: {}: {} cuts, {cuts_with_loss} of them with messages lost, 0 panics",
            kind.name,
            whole.len()
        );
    }
}

#[test]
fn recovered_and_lost_add_up_for_any_changed_byte() {
    for kind in KINDS {
        let whole = file(kind);
        let (mut with_loss, mut unnoticed, mut most_lost) = (0, 0, 0);
        for at in 0..whole.len() {
            for flip in [0x01, 0x80] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                let what = format!("{} byte {at} ^ {flip:#04x}", kind.name);
                let found = inspect(Cursor::new(&bytes));
                read(&bytes);
                let recovery = recovered(&bytes, &what).unwrap();
                let messages = recovery.messages;
                if at < 8 {
                    assert!(found.is_err() && !recovery.is_clean(), "{what}");
                    assert_eq!(messages.recovered, MESSAGES, "{what}");
                    continue;
                }
                let found = found.unwrap();
                let sum = messages.recovered + messages.lost;
                // A changed opcode may create a message of a channel; its chunk is then suspect, or
                // outside of chunks the whole data section.
                let most = MESSAGES + messages.suspect + u64::from(recovery.doubt);
                let more = sum > MESSAGES && sum <= most;
                let less = recovery.lost_unknown && sum < MESSAGES;
                assert!(sum == MESSAGES || more || less, "{what}: {recovery}");
                with_loss += u64::from(messages.lost > 0 || recovery.lost_unknown);
                unnoticed += u64::from(found.is_sound());
                most_lost = most_lost.max(messages.lost);
            }
        }
        println!(
            "figure: {}: {} changes, {with_loss} with loss or doubt, at most {most_lost} of {MESSAGES} messages lost, {unnoticed} not noticed",
            kind.name,
            2 * whole.len()
        );
        // The header of a file, and times of records outside of chunks, have no checksum of their
        // own; the data section has one in every finished file.
        assert_eq!(unnoticed, 0, "{}", kind.name);
    }
}

#[test]
fn no_length_in_a_file_causes_a_large_allocation() {
    for kind in KINDS {
        let whole = file(kind);
        for at in (8..whole.len() - 8).step_by(7) {
            let mut bytes = whole.clone();
            // Eight bytes that encode 2^56 as a length, at any offset.
            bytes[at..at + 8].copy_from_slice(&(1_u64 << 56).to_le_bytes());
            let ((), used) = counting::peak(|| {
                let _ = inspect(Cursor::new(&bytes));
                let _ = read(&bytes);
                let _ = recover(Cursor::new(&bytes), Cursor::new(Vec::new()));
            });
            assert!(used < MAX_BYTES, "{} at {at}: {used} bytes", kind.name);
            for length in [u32::MAX, 0x7fff_fff0] {
                bytes[at..at + 4].copy_from_slice(&length.to_le_bytes());
                let ((), used) = counting::peak(|| {
                    let _ = inspect(Cursor::new(&bytes));
                    let _ = read(&bytes);
                    let _ = recover(Cursor::new(&bytes), Cursor::new(Vec::new()));
                });
                assert!(used < MAX_BYTES, "{} at {at}: {used} bytes", kind.name);
            }
        }
    }
}

#[test]
fn messages_lost_within_a_chunk_do_not_affect_other_chunks() {
    let kind = KINDS[1];
    let whole = file(kind);
    let mut scan = Scan::new(Cursor::new(&whole)).unwrap();
    let mut chunks = Vec::new();
    while let Some(event) = scan.next_event().unwrap() {
        if let Event::ChunkBegins(frame) = event {
            chunks.push(frame);
        }
    }
    assert!(chunks.len() > 3);
    let mut bytes = whole;
    let second = &chunks[1];
    let records_at = usize::try_from(second.offset).unwrap() + 49 + 4;
    bytes[records_at..records_at + 4].fill(0xee);
    let recovery = recovered(&bytes, "a chunk").unwrap();
    assert_eq!(recovery.chunks.lost, 1);
    assert!(recovery.messages.lost > 0 && recovery.messages.lost < 12, "{recovery}");
    assert_eq!(recovery.messages.recovered + recovery.messages.lost, MESSAGES);
}

#[test]
fn a_channel_lost_in_the_data_is_taken_from_the_summary() {
    let whole = file(KINDS[3]);
    let mut scan = Scan::new(Cursor::new(&whole)).unwrap();
    let mut at = 0;
    while let Some(event) = scan.next_event().unwrap() {
        if let Event::Record(raw) = event
            && let Record::Channel(channel) = raw.parse().unwrap()
            && channel.topic == "b"
        {
            at = usize::try_from(raw.place.offset).unwrap();
            break;
        }
    }
    let mut bytes = whole;
    // The length of its topic exceeds the record.
    bytes[at + 9 + 4] = 0xff;
    let recovery = recovered(&bytes, "channel").unwrap();
    assert_eq!(recovery.messages.recovered, MESSAGES, "{recovery}");
    assert!(!recovery.is_clean());
}

/// A file whose first chunk is lost with the channels in it, and a later chunk has a wrong
/// checksum.
#[test]
fn a_message_without_a_channel_is_lost_and_not_also_suspect() {
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .emit_summary_records(false)
        .create(Cursor::new(Vec::new()))
        .unwrap();
    let channel = writer.add_channel(0, "a", "", &BTreeMap::new()).unwrap();
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 1,
        publish_time: 1,
    };
    writer.write_to_known_channel(&header, b"data").unwrap();
    writer.finish().unwrap();
    let mut bytes = writer.into_inner().into_inner();
    let mut scan = Scan::new(Cursor::new(&bytes)).unwrap();
    let mut chunk_at = 0;
    while let Some(event) = scan.next_event().unwrap() {
        if let Event::ChunkBegins(frame) = event {
            chunk_at = usize::try_from(frame.offset).unwrap();
        }
    }
    // The channel id in its first record: the message's channel no longer exists.
    bytes[chunk_at + 9 + 40 + 9] ^= 0x40;
    let recovery = recovered(&bytes, "a channel of another number").unwrap();
    let messages = recovery.messages;
    assert_eq!((messages.recovered, messages.lost), (0, 1), "{recovery}");
    assert_eq!((messages.suspect, recovery.chunks.suspect), (0, 1), "{recovery}");
}

/// The decompressed size claimed in the chunk's head is within a reader's limit, but not within the
/// file.
#[test]
fn a_reader_does_not_allocate_a_claimed_chunk_size() {
    for kind in KINDS.into_iter().filter(|kind| kind.chunks) {
        let mut bytes = file(kind);
        let mut scan = Scan::new(Cursor::new(&bytes)).unwrap();
        let mut chunks = Vec::new();
        while let Some(event) = scan.next_event().unwrap() {
            if let Event::ChunkBegins(frame) = event {
                chunks.push(usize::try_from(frame.offset).unwrap());
            }
        }
        for at in chunks {
            bytes[at + 9 + 16..][..8].copy_from_slice(&(200_u64 << 20).to_le_bytes());
        }
        let (read, used) = counting::peak(|| read(&bytes));
        assert_eq!(read, 0, "{}", kind.name);
        assert!(used < MAX_BYTES, "{}: {used} bytes", kind.name);
    }
}

/// The library reads to the end of an entry, and then interprets the following bytes as a length.
#[test]
fn an_index_whose_length_ends_within_an_entry_causes_no_allocation() {
    let mut rest = [0; 38];
    rest[9] = 9;
    rest[18..22].copy_from_slice(&(1_u32 << 28).to_le_bytes());
    let index = [&[0; 32][..], &1_u32.to_le_bytes(), &rest].concat();
    let mut bytes = mcap::MAGIC.to_vec();
    for (opcode, body) in [(op::HEADER, &[0; 8][..]), (op::CHUNK_INDEX, &index)] {
        bytes.push(opcode);
        bytes.extend((body.len() as u64).to_le_bytes());
        bytes.extend(body);
    }
    let ((), used) = counting::peak(|| {
        let _ = inspect(Cursor::new(&bytes));
        read(&bytes);
        let _ = recover(Cursor::new(&bytes), Cursor::new(Vec::new()));
    });
    assert!(used < MAX_BYTES, "{used} bytes");
}

/// A file of chunks, each of `records` compressed records of this kind.
fn compressed(record: &[u8], records: usize, chunks: usize) -> Vec<u8> {
    let mut file = mcap::MAGIC.to_vec();
    let mut put = |opcode: u8, body: &[u8]| {
        file.push(opcode);
        file.extend((body.len() as u64).to_le_bytes());
        file.extend(body);
    };
    put(mcap::records::op::HEADER, &[0; 8]);
    let uncompressed = (record.len() * records) as u64;
    let data = zstd::encode_all(record.repeat(records).as_slice(), 1).unwrap();
    let mut chunk = vec![0; 16];
    chunk.extend(uncompressed.to_le_bytes());
    chunk.extend([0; 4]);
    chunk.extend(4_u32.to_le_bytes());
    chunk.extend(b"zstd");
    chunk.extend((data.len() as u64).to_le_bytes());
    chunk.extend(data);
    for _ in 0..chunks {
        put(mcap::records::op::CHUNK, &chunk);
    }
    file
}

#[test]
fn the_work_of_reading_a_small_file_is_bounded() {
    // A valid record of an application, 1 MiB long.
    let mut large = vec![0x80];
    large.extend((1_u64 << 20).to_le_bytes());
    large.resize(9 + (1 << 20), 0);
    // Opcode 0 is invalid: the first of many such records ends the chunk.
    for (record, records, chunks, wrong) in [
        (&[0; 9][..], 7 << 20, 1, true),
        (&large[..], 60, 1, false),
        (&large[..], 70, 1, true),
        (&large[..], 30, 3, true),
    ] {
        let file = compressed(record, records, chunks);
        assert!(file.len() < 100_000, "{} bytes", file.len());
        let end = match Reader::new(Cursor::new(&file)) {
            Ok(mut reader) => reader.find_map(Result::err),
            Err(error) => Some(error),
        };
        assert_eq!(matches!(end, Some(ReadError::Damaged { .. })), wrong, "{records}: {end:?}");
        let mut scan = Scan::new(Cursor::new(&file)).unwrap();
        let mut events = 0;
        let end = loop {
            match scan.next_event() {
                Ok(Some(_)) => events += 1,
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
        assert!(events < 200, "{records}: {events} events");
        // The file is truncated in any case.
        assert!(end.is_err(), "{records}");
    }
}
