//! What an export has in memory.

use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::{EXPORT, parquet, recordings};

/// Largest resident set of a process so far, bytes; none once it has ended.
fn peak_bytes(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib << 10)
}

#[test]
fn an_export_of_a_long_capture_holds_a_part_of_its_samples() {
    const FRAMES: u64 = 50_000;
    const ROBOTS: u32 = 50;
    // Samples alone have 64 bytes each, and their tables more.
    const MOST_BYTES: u64 = 256 << 20;
    let samples = FRAMES * u64::from(ROBOTS);
    let place = tempfile::tempdir().unwrap();
    let run = recordings::capture(place.path(), "long.mcap", FRAMES, ROBOTS);
    let archive = place.path().join("archive");
    let mut command = Command::new(EXPORT);
    command.arg(&run).args(["--to", "parquet"]).arg(&archive);
    let mut export = command.stdout(Stdio::null()).spawn().unwrap();
    let mut peak = 0;
    let ended = loop {
        peak = peak.max(peak_bytes(export.id()).unwrap_or_default());
        if let Some(ended) = export.try_wait().unwrap() {
            break ended;
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    assert!(ended.success());
    // One run of each robot, and another of the one that began again.
    assert_eq!(parquet(&archive).len(), ROBOTS as usize + 1);
    println!("figure: {samples} samples, {peak} bytes of memory at most");
    assert!(
        peak > 0 && peak < MOST_BYTES,
        "{peak} bytes for {samples} samples"
    );
}
