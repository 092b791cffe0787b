//! Captures with a change.

use std::fs::File;
use std::path::Path;

use joulebus_capture_format::{CaptureSettings, Message, Reader, Times, Writer};

/// Writes a copy of the capture with one message changed, as the recorder would have written it.
///
/// # Panics
/// `spoil` returned `true` for no message, or the files cannot be read and written.
pub fn spoilt(file: &Path, to: &Path, spoil: impl Fn(&mut Message) -> bool) {
    let reader = Reader::open(file).expect("a capture");
    let attachments = reader.attachments().clone();
    let to = File::create_new(to).expect("a new file");
    let mut writer = Writer::new(to, CaptureSettings::default(), &attachments).expect("a capture");
    let mut done = false;
    for entry in reader {
        let mut entry = entry.expect("a capture");
        done = done || spoil(&mut entry.message);
        let times = Times { log_ns: entry.log_time_ns, publish_ns: entry.publish_time_ns };
        writer.write(&entry.fleet, times, &entry.message).expect("a capture");
    }
    assert!(done, "nothing was spoilt");
    writer.finish().expect("a capture");
}
