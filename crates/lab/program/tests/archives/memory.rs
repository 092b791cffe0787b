//! Memory use of an export.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use joulebus_testkit::joulebus_beside;

use crate::{LAB, export, parquet, recordings};

/// Largest resident set of a process so far, bytes; none once it has ended.
fn peak_bytes(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib << 10)
}

/// Largest resident set of a program, bytes, which must end well.
fn peak_of(command: &mut Command) -> u64 {
    let mut program = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut peak = 0;
    let ended = loop {
        peak = peak.max(peak_bytes(program.id()).unwrap_or_default());
        if let Some(ended) = program.try_wait().unwrap() {
            break ended;
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    assert!(ended.success());
    peak
}

#[test]
fn an_export_of_a_long_capture_holds_a_part_of_its_samples() {
    const FRAMES: u64 = 50_000;
    const ROBOTS: u32 = 50;
    // Samples alone have 64 bytes each, and their tables more.
    const MAX_BYTES: u64 = 256 << 20;
    let samples = FRAMES * u64::from(ROBOTS);
    let place = tempfile::tempdir().unwrap();
    let run = recordings::capture(place.path(), "long.mcap", FRAMES, ROBOTS);
    let archive = place.path().join("archive");
    let mut command = Command::new(LAB);
    command.arg("export").arg(&run).args(["--to", "parquet"]).arg(&archive);
    let peak = peak_of(&mut command);
    // One run of each robot, and another of the one that began again.
    assert_eq!(parquet(&archive).len(), ROBOTS as usize + 1);
    println!("figure: {samples} samples, {peak} bytes of memory at most");
    assert!(peak > 0 && peak < MAX_BYTES, "{peak} bytes for {samples} samples");
}

/// An archive of some trials of as many rows each.
fn archive_of(trials: u64, rows: u64, place: &Path) -> PathBuf {
    let runs = place.join(format!("runs_{trials}"));
    fs::create_dir(&runs).unwrap();
    for number in 0..trials {
        recordings::full(&runs, &format!("{number:03}.csv"), rows, number);
    }
    let archive = place.join(format!("archive_{trials}"));
    export(&[&runs], &archive).exits(0);
    archive
}

#[test]
fn verbs_that_read_an_archive_hold_no_more_of_more_trials() {
    // A row in memory has some 300. Sums of an evaluation grow until they are joined, or go to a
    // file.
    const MAX_BYTES_A_ROW: u64 = 40;
    // More rows than stay in memory, and trials that are small beside them.
    const TRIALS: u64 = 100;
    const ROWS: u64 = 6_000;
    let place = tempfile::tempdir().unwrap();
    let model = Path::new(env!("CARGO_MANIFEST_DIR"));
    let model = model.join("../../../configs/models/gternal-sim.safetensors");
    let model = model.to_str().unwrap();
    let out = place.path().join("made.safetensors");
    let recipe = place.path().join("short.toml");
    fs::write(&recipe, "[training]\nmax_epochs = 1\n").unwrap();
    let [out, recipe] = [&out, &recipe].map(|path| path.to_str().unwrap());
    let verbs: [&[&str]; 3] = [
        &["eval", "--resamples", "0", "--horizons", "1", "--model", model],
        &["analyze", "--model", model],
        &["train", "trials", "--recipe", recipe, "--most-rows", "20000", "--out", out],
    ];
    let archives = [TRIALS, 2 * TRIALS].map(|trials| archive_of(trials, ROWS, place.path()));
    for verb in verbs {
        let [few, many] = archives.each_ref().map(|archive| {
            let mut command = Command::new(joulebus_beside(LAB));
            // The buffers of one thread.
            command.env("RAYON_NUM_THREADS", "1").args(verb);
            peak_of(command.arg(archive))
        });
        let a_row = many.saturating_sub(few) / (TRIALS * ROWS);
        println!("figure: {verb:?}: {few} and {many} bytes of memory at most, {a_row} a row");
        assert!(
            0 < few && a_row < MAX_BYTES_A_ROW,
            "{verb:?}: {few} and {many} bytes, {a_row} a row"
        );
    }
}
