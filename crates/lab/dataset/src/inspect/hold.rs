//! Held readings and their pattern, which shows how often the sensor was really read.

use serde::Serialize;

use crate::trial::Trial;

/// Pattern of held readings. A reading is held if power, voltage and current all equal the previous
/// row's to the bit. A constant load below the sensor's resolution looks the same.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Holds {
    /// Rows with a reading.
    pub readings: usize,
    /// Number of readings equal to the previous row's.
    pub held: usize,
    /// `held / readings`. 0 without readings.
    pub share: f64,
    /// Most frequent run length, rows: 1 if most readings are new. Of two equally frequent lengths,
    /// the shorter.
    pub usual_rows: usize,
    /// Share of the runs with this length.
    pub usual_share: f64,
    /// New readings per second, over the whole trial.
    pub new_hz: f64,
    /// The longest run, rows.
    pub longest_rows: usize,
    /// Its first row in the file, from 1.
    pub longest_at_row: usize,
    /// Its length, s: from its first row to its last.
    pub longest_s: f64,
}

/// A run of equal readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    /// First row, from 0.
    pub(super) from: usize,
    /// Number of rows.
    pub(super) rows: usize,
}

/// The runs of equal readings, in order. Rows without a reading belong to none and end a run.
pub(super) fn runs(trial: &Trial) -> Vec<Run> {
    let power = trial.column(crate::trial::Column::Power);
    let mut runs: Vec<Run> = Vec::new();
    for row in 0..trial.rows() {
        let known = power.is_some_and(|values| !values[row].is_nan());
        match runs.last_mut() {
            Some(run) if trial.is_held(row) => run.rows += 1,
            _ if known => runs.push(Run { from: row, rows: 1 }),
            _ => {}
        }
    }
    runs
}

/// The pattern of held readings of a trial.
pub fn holds(trial: &Trial) -> Holds {
    let runs = runs(trial);
    let readings: usize = runs.iter().map(|run| run.rows).sum();
    let held = readings - runs.len();
    let longest = runs.iter().rev().max_by_key(|run| run.rows);
    let longest = longest.copied().unwrap_or(Run { from: 0, rows: 0 });
    let last = longest.from + longest.rows.saturating_sub(1);
    let time_s = trial.timestamp_s();
    let (usual_rows, usual_runs) = usual(&runs);
    let count = runs.len().max(1) as f64;
    Holds {
        readings,
        held,
        share: held as f64 / readings.max(1) as f64,
        usual_rows,
        usual_share: usual_runs as f64 / count,
        new_hz: runs.len() as f64 / (trial.rows() as f64 * trial.period_ns() as f64 * 1e-9),
        longest_rows: longest.rows,
        longest_at_row: trial.file_row(longest.from),
        longest_s: time_s[last] - time_s[longest.from],
    }
}

/// The most frequent length, and its number of runs.
fn usual(runs: &[Run]) -> (usize, usize) {
    let mut lengths: Vec<usize> = runs.iter().map(|run| run.rows).collect();
    lengths.sort_unstable();
    let mut usual = (0, 0);
    for group in lengths.chunk_by(|one, other| one == other) {
        if group.len() > usual.1 {
            usual = (group[0], group.len());
        }
    }
    usual
}
