//! Reading needs memory of about one record, for any length of the file.
//!
//! `JOULEBUS_CAPTURE_MB=2000` makes the file that long; release builds take seconds for it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::time::Instant;

use joulebus_capture_format::inspect::inspect;
use joulebus_capture_format::recover::recover;
use joulebus_capture_format::{
    Attachments, CaptureSettings, Message, Preset, Reader, Times, Writer,
};
use joulebus_testkit::counting;
use joulebus_wire::Forecasts;
use mcap::WriteOptions;
use mcap::records::MessageHeader;

use crate::fields::Bits;

/// Maximum memory of reading, bytes. The guarantee is 200 MB for a file of 2 GB.
const MAX_BYTES: u64 = 32 << 20;
const MESSAGE_BYTES: usize = 4096;
const USUAL_MB: u64 = 48;

fn noise(state: &mut u64, data: &mut [u8]) {
    for word in data.chunks_exact_mut(8) {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        word.copy_from_slice(&state.to_le_bytes());
    }
}

fn write(file: File, megabytes: u64) -> u64 {
    let mut writer = WriteOptions::new()
        .chunk_size(Some(1 << 20))
        .compression(Some(mcap::Compression::Lz4))
        .create(BufWriter::new(file))
        .unwrap();
    let channel = writer.add_channel(0, "noise", "bytes", &BTreeMap::new()).unwrap();
    let mut data = vec![0; MESSAGE_BYTES];
    let messages = megabytes * 1_000_000 / MESSAGE_BYTES as u64;
    let mut state = 0x9e37_79b9_7f4a_7c15;
    for number in 0..messages {
        noise(&mut state, &mut data);
        let header = MessageHeader {
            channel_id: channel,
            sequence: u32::try_from(number).unwrap(),
            log_time: number * 1_000_000,
            publish_time: number * 1_000_000,
        };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
    messages
}

fn megabytes() -> u64 {
    std::env::var("JOULEBUS_CAPTURE_MB").map_or(USUAL_MB, |text| text.parse().unwrap())
}

#[test]
fn a_long_file_is_read_in_bounded_memory() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("long.mcap");
    let messages = write(File::create(&path).unwrap(), megabytes());
    let file_mb = path.metadata().unwrap().len() as f64 / 1e6;
    let open = || File::open(&path).unwrap();
    let rate = |start: Instant| file_mb / start.elapsed().as_secs_f64();

    let start = Instant::now();
    let (found, used) = counting::peak(|| inspect(open()).unwrap());
    assert!(found.is_sound() && found.messages == messages);
    assert!(used < MAX_BYTES, "inspect: {used} bytes");
    println!(
        "figure: inspect {file_mb:.0} MB at {:.0} MB/s in {:.1} MB of memory",
        rate(start),
        used as f64 / 1e6
    );

    let whole = directory.path().join("whole.mcap");
    let start = Instant::now();
    let ((recovery, _), used) =
        counting::peak(|| recover(open(), File::create(&whole).unwrap()).unwrap());
    assert!(recovery.is_clean() && recovery.messages.recovered == messages, "{recovery}");
    assert!(used < MAX_BYTES, "recover: {used} bytes");
    println!(
        "figure: recover {file_mb:.0} MB at {:.0} MB/s in {:.1} MB of memory",
        rate(start),
        used as f64 / 1e6
    );
}

#[test]
fn a_long_capture_is_read_in_bounded_memory() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("long.mcap");
    let settings = CaptureSettings::new(Preset::FastWrite);
    let file = File::create_new(&path).unwrap();
    let mut writer = Writer::new(file, settings, &Attachments::default()).unwrap();
    // 100 robots at 30 Hz, with incompressible bits.
    let mut bits = Bits(1);
    let rows = (0..100).map(|_| bits.row()).collect();
    let message = Message::of::<Forecasts>(bits.row(), rows);
    let mut written = 0;
    while writer.bytes() < megabytes() << 20 {
        let times = Times { log_ns: written * 33_333_333, publish_ns: 0 };
        writer.write("lab", times, &message).unwrap();
        written += 1;
    }
    writer.finish().unwrap();
    let (read, used) = counting::peak(|| {
        let mut reader = Reader::open(&path).unwrap();
        let mut read = 0;
        while let Some(entry) = reader.next_entry().unwrap() {
            assert_eq!(entry.log_time_ns, read * 33_333_333);
            read += 1;
        }
        read
    });
    assert_eq!(read, written);
    println!("figure: reading took {used} bytes of memory");
    assert!(used < MAX_BYTES, "{used} bytes");
}
