//! Memory of verbs that read more recordings than it holds.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use joulebus_testkit::joulebus_beside;

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

/// A folder with some trials of as many rows each.
fn recordings(trials: u64, rows: u64, place: &Path) -> PathBuf {
    let runs = place.join(format!("runs_{trials}"));
    fs::create_dir(&runs).unwrap();
    for trial in 0..trials {
        let row = |row: u64| {
            let at_s = row as f64 / 30.0;
            let noise = (row.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ trial) % 1000;
            let [v, omega] = [0.1 + 0.05 * at_s.sin(), (0.3 * at_s).cos()];
            let power_w = 12.0 + 3.0 * (0.7 * at_s).sin() + 0.0004 * noise as f64;
            format!("{at_s},{v},{omega},{power_w}\n")
        };
        let text: String = (0..rows).map(row).collect();
        let head = "timestamp_s,v_cmd_mps,omega_cmd_radps,power_W\n";
        fs::write(runs.join(format!("{trial:03}.csv")), head.to_owned() + &text).unwrap();
    }
    runs
}

#[test]
fn verbs_hold_no_more_of_more_trials() {
    // A row in memory has some 300. Sums of an evaluation grow until they are joined, or go to a
    // file.
    const MAX_BYTES_A_ROW: u64 = 40;
    // More rows than stay in memory, and trials that are small beside them.
    const TRIALS: u64 = 100;
    const ROWS: u64 = 6_000;
    let lab = env!("CARGO_BIN_EXE_joulebus-lab");
    let place = tempfile::tempdir().unwrap();
    let model = Path::new(env!("CARGO_MANIFEST_DIR"));
    let model = model.join("../../../configs/models/gternal-sim.safetensors");
    let model = model.to_str().unwrap();
    let out = place.path().join("made.safetensors");
    let recipe = place.path().join("short.toml");
    fs::write(&recipe, "[training]\nmax_epochs = 1\n").unwrap();
    let [out, recipe] = [&out, &recipe].map(|path| path.to_str().unwrap());
    let verbs: [&[&str]; 3] = [
        &["eval", "--resamples", "0", "--model", model],
        &["analyze", "--model", model],
        &["train", "trials", "--recipe", recipe, "--most-rows", "20000", "--out", out],
    ];
    let folders = [TRIALS, 2 * TRIALS].map(|trials| recordings(trials, ROWS, place.path()));
    for verb in verbs {
        let [few, many] = folders.each_ref().map(|folder| {
            let mut command = Command::new(joulebus_beside(lab));
            // The buffers of one thread.
            command.env("RAYON_NUM_THREADS", "1").args(verb);
            peak_of(command.arg(folder))
        });
        let a_row = many.saturating_sub(few) / (TRIALS * ROWS);
        println!("figure: {verb:?}: {few} and {many} bytes of memory at most, {a_row} a row");
        assert!(
            0 < few && a_row < MAX_BYTES_A_ROW,
            "{verb:?}: {few} and {many} bytes, {a_row} a row"
        );
    }
}
