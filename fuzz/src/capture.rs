//! MCAP files: scanned, recovered, imported.

#[path = "../../crates/capture/format/tests/bounded/damaged.rs"]
#[allow(dead_code)] // The tests damage its files; here the input is already damaged.
pub(crate) mod damaged;

use std::io::Cursor;

use joulebus_capture_format::import::{Imported, Mapping};
use joulebus_capture_format::inspect::inspect;
use joulebus_capture_format::scan::{Event, Scan, ScanError};

/// Maximum length of an input, bytes; offsets are below it.
fn place_lies_in(offset: u64, bytes: &[u8]) {
    assert!(offset <= bytes.len() as u64, "byte {offset} of {}", bytes.len());
}

pub(crate) fn scan(bytes: &[u8]) -> bool {
    let Ok(mut scan) = Scan::new(Cursor::new(bytes)) else {
        assert!(inspect(Cursor::new(bytes)).is_err());
        return false;
    };
    let (mut messages, mut before) = (0, 0);
    loop {
        match scan.next_event() {
            Ok(Some(Event::Record(raw))) => {
                place_lies_in(raw.place.offset, bytes);
                assert!(raw.place.offset >= before, "{} after {before}", raw.place);
                before = raw.place.offset;
                let _ = raw.parse();
                messages += u64::from(raw.opcode == mcap::records::op::MESSAGE);
            }
            Ok(Some(_)) => {}
            Ok(None) => break,
            Err(error) => {
                assert!(!matches!(error, ScanError::Io { .. }), "{error}");
                place_lies_in(error.place().offset, bytes);
                match scan.resume().expect("memory can be read") {
                    Some(skipped) => assert!(skipped.from <= skipped.to),
                    None => break,
                }
            }
        }
    }
    let found = inspect(Cursor::new(bytes)).expect("its first bytes are those of an MCAP file");
    assert!(found.messages <= messages, "{} > {messages}", found.messages);
    assert_eq!(found.is_sound(), found.errors == 0);
    let read = damaged::read(bytes);
    assert!(read <= messages, "{read} > {messages}");
    read > 0
}

pub(crate) fn recover(bytes: &[u8]) -> bool {
    let Some(recovery) = damaged::recovered(bytes, "input") else {
        return false;
    };
    let sum: u64 = recovery.topics.values().sum();
    assert_eq!(sum, recovery.messages.recovered);
    assert!(recovery.messages.suspect <= recovery.messages.recovered, "{recovery}");
    assert!(recovery.passed_over_bytes <= bytes.len() as u64, "{recovery}");
    assert!(recovery.troubles.len() as u64 <= recovery.trouble_count);
    recovery.messages.recovered > 0
}

/// Options of the import, by an input's first byte.
const MAPPINGS: [&str; 4] = [
    "",
    "time = \"log\"\nburst_s = 0.0\ncurrent = \"discharge-positive\"",
    "time = \"header\"\nodometry_max_age_s = 0.0",
    "time = \"publish\"\n[[robot]]\nname = \"r\"\nbattery = \"/r/battery\"\ncommand = \"/r/cmd_vel\"\n\
     odometry = \"/r/odom\"\nvoltage_unit_v = 0.001",
];

pub(crate) fn import(bytes: &[u8]) -> bool {
    let Some((which, bytes)) = bytes.split_first() else {
        return false;
    };
    let mapping: Mapping =
        MAPPINGS[usize::from(*which) % MAPPINGS.len()].parse().expect("a sound mapping");
    let Ok(imported) = joulebus_capture_format::import::import(Cursor::new(bytes), "bag", &mapping)
    else {
        return false;
    };
    adds_up(&imported);
    imported.robots.iter().any(|robot| robot.row_count > 0)
}

fn adds_up(imported: &Imported) {
    for robot in &imported.robots {
        assert_eq!(robot.row_count, robot.rows.len() as u64);
        let times = robot.rows.windows(2).all(|pair| pair[0].time_ns <= pair[1].time_ns);
        assert!(times, "{}: rows out of order", robot.name);
        for row in &robot.rows {
            let power_w = row.voltage_v * row.current_a;
            assert!(row.voltage_v.is_finite() && row.current_a.is_finite(), "{row:?}");
            assert_eq!(row.power_w.to_bits(), power_w.to_bits(), "{row:?}");
        }
        let refused: u64 = robot.battery.refused.values().sum();
        assert_eq!(
            refused + robot.row_count + robot.merged_in_bursts,
            robot.battery.messages,
            "{:?}",
            robot.battery
        );
    }
    assert!(!imported.to_string().is_empty());
}
