//! A platform's profile from recordings: rate, ranges, resolution, holds, and steps of the
//! readings.

use joulebus_plausibility::resolution;
use serde::Serialize;

use super::hold::runs;
use crate::trial::{Column, Trial};

/// A step longer than this many median steps is a gap.
const MAX_STEP: f64 = 1.5;

/// A platform as its recordings show it. SI units.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Profile {
    /// Trials.
    pub trials: usize,
    /// Readings.
    pub readings: usize,
    /// Median of the trials' rates, rows a second.
    pub rate_hz: f64,
    /// Lowest and highest reading, W.
    pub power_w: (f64, f64),
    /// Step of the readings, W, if they have one.
    pub resolution_w: Option<f64>,
    /// Root mean square of the difference of consecutive readings, W.
    pub difference_w: f64,
    /// Usual time that a reading is held, s: the longest of the trials' means.
    pub usual_hold_s: f64,
    /// Longest time with equal readings, s.
    pub longest_hold_s: f64,
    /// Largest |v|, m/s, if it is recorded.
    pub v_mps: Option<f64>,
    /// Largest |ω|, rad/s, if it is recorded.
    pub omega_radps: Option<f64>,
    /// Lowest and highest battery voltage, V, if it is recorded.
    pub voltage_v: Option<(f64, f64)>,
}

/// The profile of some trials; `None` if they have fewer than two readings or constant power.
pub fn profile(trials: &[Trial]) -> Option<Profile> {
    let mut readings: Vec<f64> = known(trials, Column::Power).collect();
    readings.sort_unstable_by(f64::total_cmp);
    let (least, greatest) = (*readings.first()?, *readings.last()?);
    // All of them are finite.
    if least == greatest {
        return None;
    }
    let mut periods: Vec<u64> = trials.iter().map(Trial::period_ns).collect();
    periods.sort_unstable();
    let period_ns = periods[periods.len() / 2];
    let (mut usual_hold_s, mut longest_hold_s) = (0.0_f64, 0.0_f64);
    for trial in trials {
        let period_s = trial.period_ns() as f64 * 1e-9;
        let runs = runs(trial);
        let rows: usize = runs.iter().map(|run| run.rows).sum();
        let mean = rows as f64 / runs.len().max(1) as f64;
        let longest = runs.iter().map(|run| run.rows).max().unwrap_or(1);
        usual_hold_s = usual_hold_s.max(mean * period_s);
        longest_hold_s = longest_hold_s.max(longest as f64 * period_s);
    }
    let largest = |column| {
        let sizes = known(trials, column).map(f64::abs);
        sizes.reduce(f64::max)
    };
    let voltage = || known(trials, Column::Voltage);
    Some(Profile {
        trials: trials.len(),
        readings: readings.len(),
        rate_hz: 1e9 / period_ns as f64,
        power_w: (least, greatest),
        resolution_w: resolution(&readings),
        difference_w: difference(trials)?,
        usual_hold_s,
        longest_hold_s,
        v_mps: largest(Column::V),
        omega_radps: largest(Column::Omega),
        voltage_v: voltage().reduce(f64::min).zip(voltage().reduce(f64::max)),
    })
}

/// The recorded values of a column.
fn known(trials: &[Trial], column: Column) -> impl Iterator<Item = f64> {
    let columns = trials.iter().filter_map(move |trial| trial.column(column));
    columns.flatten().copied().filter(|value| value.is_finite())
}

/// Root mean square of the difference of consecutive readings without a gap between them.
fn difference(trials: &[Trial]) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_u64);
    for trial in trials {
        let Some(power) = trial.column(Column::Power) else {
            continue;
        };
        let longest_ns = (trial.period_ns() as f64 * MAX_STEP) as i64;
        let steps = trial.offset_ns().windows(2).zip(power.windows(2));
        for (times, readings) in steps {
            let difference = readings[1] - readings[0];
            let step_ns = times[1] - times[0];
            if difference.is_finite() && step_ns > 0 && step_ns <= longest_ns {
                sum += difference * difference;
                count += 1;
            }
        }
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}
