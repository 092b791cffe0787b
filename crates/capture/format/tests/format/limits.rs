//! A writer that fails after any number of bytes: no panic, the failure is reported, and everything
//! flushed before is readable.

use std::io::{self, Cursor, Write};

use joulebus_capture_format::{
    Attachments, CaptureSettings, Entry, Message, MessageKind, Preset, ReadError, Reader,
    Sequences, Times, WriteError, Writer, Written,
};
use joulebus_wire::{Samples, Ticks};

use crate::fields::{Bits, messages};

/// A disk of limited size.
#[derive(Debug)]
struct Disk<'a> {
    bytes: &'a mut Vec<u8>,
    room: usize,
}

impl Write for Disk<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let fits = bytes.len().min(self.room - self.bytes.len());
        if fits == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.bytes.extend_from_slice(&bytes[..fits]);
        Ok(fits)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn attachments() -> Attachments {
    let mut attachments = Attachments::default();
    attachments.add("lab/config.toml".to_owned(), "application/toml", vec![7; 50]);
    attachments
}

/// Writes everything, one chunk per two messages; returns the end of each flush.
fn write(
    disk: Disk<'_>,
    preset: Preset,
    all: &[Message],
    flushed: &mut Vec<(u64, usize)>,
) -> Result<Written, WriteError> {
    let mut writer = Writer::new(disk, CaptureSettings::new(preset), &attachments())?;
    for (number, message) in all.iter().enumerate() {
        let times = Times { log_ns: number as u64, publish_ns: number as u64 };
        let written = writer.write("lab", times, message);
        if written.is_err() {
            // Further calls fail again, and corrupt nothing.
            assert!(matches!(writer.write("lab", times, message), Err(WriteError::Stopped)));
        }
        written?;
        if number % 2 == 1 {
            writer.flush()?;
            flushed.push((writer.bytes(), number + 1));
        }
    }
    let (written, Sequences { .. }, _) = writer.finish()?;
    Ok(written)
}

/// The readable messages, and the error that ends them.
fn read(file: &[u8]) -> (Vec<Entry>, Option<ReadError>) {
    let mut reader = match Reader::new(Cursor::new(file)) {
        Ok(reader) => reader,
        Err(error) => return (Vec::new(), Some(error)),
    };
    let mut found = Vec::new();
    loop {
        match reader.next_entry() {
            Ok(Some(entry)) => found.push(entry),
            Ok(None) => return (found, None),
            Err(error) => return (found, Some(error)),
        }
    }
}

fn try_all(preset: Preset, step: usize) {
    // Few schemas keep the file small, and so the number of limits.
    let few = [
        MessageKind::of::<Samples>(),
        MessageKind::of::<Ticks>(),
        MessageKind::of_robot::<Samples>(),
    ];
    let mut all = messages(&mut Bits(3));
    all.extend(messages(&mut Bits(4)));
    all.retain(|message| few.contains(&message.kind().unwrap()));
    let mut whole = Vec::new();
    let mut flushed = Vec::new();
    let disk = Disk { bytes: &mut whole, room: usize::MAX };
    write(disk, preset, &all, &mut flushed).unwrap();
    for room in (0..=whole.len()).step_by(step) {
        let mut file = Vec::new();
        let disk = Disk { bytes: &mut file, room };
        let written = write(disk, preset, &all, &mut Vec::new());
        let fits = room == whole.len();
        assert_eq!(written.is_ok(), fits, "{preset:?}, room for {room} bytes");
        if let Err(error) = written {
            let text = error.to_string();
            assert!(text.contains("storage") || text.contains("space"), "{text}");
        }
        assert_eq!(file, whole[..room], "nothing but the beginning");
        let (found, end) = read(&file);
        let found: Vec<Message> = found.into_iter().map(|entry| entry.message).collect();
        assert_eq!(found, all[..found.len()]);
        let safe = flushed.iter().rev().find(|(bytes, _)| *bytes <= room as u64);
        let safe = safe.map_or(0, |(_, messages)| *messages);
        assert!(found.len() >= safe, "room for {room}: {} of {safe}", found.len());
        assert_eq!(end.is_none(), fits, "room for {room}: {end:?}");
    }
}

#[test]
fn every_limit_of_a_small_capture_is_reported_and_loses_only_unflushed_messages() {
    try_all(Preset::ZstdFast, 1);
}

#[test]
fn the_same_holds_for_the_other_presets() {
    for preset in [Preset::FastWrite, Preset::Lz4, Preset::ZstdSmall] {
        try_all(preset, 13);
    }
}
