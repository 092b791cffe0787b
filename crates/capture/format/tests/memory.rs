//! Captures of any length are read in bounded memory. `JOULEBUS_CAPTURE_MB=2048` for a long one.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod fields;

use std::fs;

use joulebus_capture_format::{
    Attachments, CaptureSettings, Message, Preset, Reader, Times, Writer,
};

use fields::Bits;
use joulebus_wire::Forecasts;

/// A value in `/proc/self/status`, bytes.
fn memory(name: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with(name)).unwrap();
    let kilobytes = line.split_whitespace().nth(1).unwrap();
    kilobytes.parse::<u64>().unwrap() * 1024
}

#[test]
fn a_long_capture_is_read_in_bounded_memory() {
    let megabytes = std::env::var("JOULEBUS_CAPTURE_MB");
    let bytes = megabytes.map_or(100, |text| text.parse().unwrap()) << 20;
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("long.mcap");
    let settings = CaptureSettings::new(Preset::FastWrite);
    let mut writer =
        Writer::new(fs::File::create_new(&path).unwrap(), settings, &Attachments::default())
            .unwrap();
    // 100 robots at 30 Hz, with incompressible bits.
    let mut bits = Bits(1);
    let rows = (0..100).map(|_| bits.row()).collect();
    let message = Message::of::<Forecasts>(bits.row(), rows);
    let mut written = 0;
    while writer.bytes() < bytes {
        let times = Times { log_ns: written * 33_333_333, publish_ns: 0 };
        writer.write("lab", times, &message).unwrap();
        written += 1;
    }
    writer.finish().unwrap();

    // Resets the peak, so that it is that of reading.
    fs::write("/proc/self/clear_refs", "5").unwrap();
    let before = memory("VmRSS");
    let mut reader = Reader::open(&path).unwrap();
    let mut read = 0;
    while let Some(entry) = reader.next_entry().unwrap() {
        assert_eq!(entry.log_time_ns, read * 33_333_333);
        read += 1;
    }
    assert_eq!(read, written);
    let grown = memory("VmHWM").saturating_sub(before);
    println!("figure: reading {bytes} bytes took {grown} bytes of memory");
    assert!(grown < 32 << 20, "{grown} bytes for {bytes}");
}
