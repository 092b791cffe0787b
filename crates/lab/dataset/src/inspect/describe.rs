//! Description of a trial: rows, rate, holds, ranges.

use std::path::PathBuf;

use serde::Serialize;

use super::constant::only_value;
use super::hold::{Holds, holds};
use super::units::{PowerCheck, power_check};
use crate::split::group_of;
use crate::trial::{Column, Trial};

/// Description of a trial. SI units. Rows count as lines of its file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialReport {
    /// The file.
    pub file: PathBuf,
    /// The robot as recorded.
    pub robot_name: Option<String>,
    /// Its group: the file's name without its number.
    pub group: String,
    /// Rows.
    pub rows: usize,
    /// Time from the first row to the latest, s.
    pub duration_s: f64,
    /// Median rate, Hz.
    pub rate_hz: f64,
    /// Distribution of the steps from row to row.
    pub steps: Steps,
    /// Steps longer than 1.5 median ones.
    pub gaps: usize,
    /// The longest gap, s.
    pub longest_gap_s: Option<f64>,
    /// Rows whose time is not later than all times before.
    pub not_advancing: usize,
    /// Readings equal to the previous one.
    pub held_readings: usize,
    /// Rows without a power reading.
    pub missing_readings: usize,
    /// Pattern of held readings.
    pub holds: Holds,
    /// Mean of the power readings, W.
    pub mean_power_w: Option<f64>,
    /// Minimum power reading, W.
    pub least_power_w: Option<f64>,
    /// Maximum power reading, W.
    pub greatest_power_w: Option<f64>,
    /// Energy, J: each reading is held until the next row. Gaps are excluded.
    pub energy_j: f64,
    /// Power compared with voltage times current, if all three are recorded.
    pub power_check: Option<PowerCheck>,
    /// Columns with values.
    pub columns: Vec<ColumnReport>,
    /// Columns without values.
    pub missing_columns: Vec<&'static str>,
    /// Constant columns.
    pub constant_columns: Vec<&'static str>,
    /// Unknown columns of the file.
    pub ignored_columns: Vec<String>,
    /// True if a CSV does not end with a newline: it may be truncated.
    pub no_final_line_break: bool,
    /// Rows without a robot name, while others have one.
    pub unnamed_rows: usize,
}

/// Quantiles of the steps that advance, s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Steps {
    /// Minimum.
    pub least_s: f64,
    /// 5 % quantile.
    pub p05_s: f64,
    /// Median.
    pub median_s: f64,
    /// 95 % quantile.
    pub p95_s: f64,
    /// Maximum.
    pub greatest_s: f64,
}

/// A column's values in the SI unit of the [`Column`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ColumnReport {
    /// Its name in a file. Files have voltage, current and power in thousandths of the SI unit.
    pub name: &'static str,
    /// Rows with a value.
    pub values: usize,
    /// Minimum.
    pub least: f64,
    /// Mean.
    pub mean: f64,
    /// Standard deviation about the mean.
    pub std: f64,
    /// Maximum.
    pub greatest: f64,
}

/// Describes a trial.
pub fn describe(trial: &Trial) -> TrialReport {
    let notes = trial.notes();
    let columns = Column::ALL.into_iter();
    let columns: Vec<_> = columns.filter_map(|column| report(trial, column)).collect();
    let power = columns.iter().find(|column| column.name == Column::Power.name());
    let longest_ns = notes.gaps.iter().map(|gap| gap.length_ns).max();
    let last_ns = trial.offset_ns().iter().max().copied().unwrap_or_default();
    let file_name = trial.path().file_name().and_then(|name| name.to_str());
    let constant = |column: &Column| only_value(trial, *column).is_some();
    TrialReport {
        file: trial.path().to_owned(),
        robot_name: trial.robot_name().map(str::to_owned),
        group: group_of(file_name.unwrap_or_default()),
        rows: trial.rows(),
        duration_s: last_ns as f64 / 1e9,
        rate_hz: notes.rate_hz,
        steps: steps(trial),
        gaps: notes.gaps.len(),
        longest_gap_s: longest_ns.map(|length_ns| length_ns as f64 / 1e9),
        not_advancing: notes.not_advancing.len(),
        held_readings: notes.held_readings,
        missing_readings: notes.missing_readings,
        holds: holds(trial),
        mean_power_w: power.map(|power| power.mean),
        least_power_w: power.map(|power| power.least),
        greatest_power_w: power.map(|power| power.greatest),
        energy_j: energy_j(trial),
        power_check: power_check(trial),
        columns,
        missing_columns: notes.missing_columns.iter().map(|c| c.name()).collect(),
        constant_columns: Column::ALL
            .iter()
            .filter(|column| constant(column))
            .map(|column| column.name())
            .collect(),
        ignored_columns: notes.ignored_columns.clone(),
        no_final_line_break: notes.no_final_line_break,
        unnamed_rows: notes.unnamed_rows,
    }
}

fn report(trial: &Trial, column: Column) -> Option<ColumnReport> {
    let known = || {
        let values = trial.column(column).unwrap_or_default().iter();
        values.copied().filter(|value| !value.is_nan())
    };
    let values = known().count();
    let mean = known().sum::<f64>() / values as f64;
    let squares: f64 = known().map(|value| (value - mean) * (value - mean)).sum();
    Some(ColumnReport {
        name: column.name(),
        values,
        least: known().reduce(f64::min)?,
        mean,
        std: (squares / values as f64).sqrt(),
        greatest: known().reduce(f64::max)?,
    })
}

/// Steps from the latest time so far to each later one, ns.
fn advances_ns(trial: &Trial) -> Vec<i64> {
    let mut latest_ns = trial.offset_ns()[0];
    let mut steps_ns = Vec::with_capacity(trial.rows());
    for now_ns in &trial.offset_ns()[1..] {
        if *now_ns > latest_ns {
            steps_ns.push(now_ns - latest_ns);
            latest_ns = *now_ns;
        }
    }
    steps_ns
}

fn steps(trial: &Trial) -> Steps {
    let mut steps_ns = advances_ns(trial);
    steps_ns.sort_unstable();
    // Every trial has at least one step that advances.
    let last = steps_ns.len().saturating_sub(1);
    let at = |share: f64| {
        let place = (share * last as f64).floor() as usize;
        steps_ns.get(place).copied().unwrap_or_default() as f64 / 1e9
    };
    Steps {
        least_s: at(0.0),
        p05_s: at(0.05),
        median_s: at(0.5),
        p95_s: at(0.95),
        greatest_s: at(1.0),
    }
}

/// Each reading is held until the next row, before a gap and at the end for a median period.
/// Missing readings and rows whose time does not advance add nothing.
fn energy_j(trial: &Trial) -> f64 {
    let Some(power_w) = trial.column(Column::Power) else {
        return 0.0;
    };
    let period_ns = trial.period_ns().cast_signed();
    let (mut energy_j, mut before) = (0.0, None::<usize>);
    let mut count = |row: usize, counts_ns: i64| {
        if !power_w[row].is_nan() {
            energy_j += power_w[row] * counts_ns as f64 * 1e-9;
        }
    };
    for (row, now_ns) in trial.offset_ns().iter().enumerate() {
        let step_ns = before.map(|before| now_ns - trial.offset_ns()[before]);
        match (before, step_ns) {
            (Some(before), Some(step_ns)) if step_ns > period_ns + period_ns / 2 => {
                count(before, period_ns);
            }
            (Some(before), Some(step_ns)) if step_ns > 0 => count(before, step_ns),
            (Some(_), _) => continue,
            (None, _) => {}
        }
        before = Some(row);
    }
    if let Some(last) = before {
        count(last, period_ns);
    }
    energy_j
}
