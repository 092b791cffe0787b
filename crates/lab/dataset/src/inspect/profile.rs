//! A platform's profile from recordings: rate, ranges, resolution, holds, and steps of the
//! readings.

use joulebus_plausibility::resolution;
use serde::Serialize;

use super::hold::runs;
use crate::trial::{Column, Trial};

/// A step longer than this many median steps is a gap.
const MAX_STEP: f64 = 1.5;

/// A trial whose readings are held for longer than this many times the median of all trials has a
/// stuck sensor, s.
const STUCK: f64 = 8.0;

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
    /// Trials whose readings are held far longer than those of the others. They count in neither.
    pub stuck: Vec<String>,
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
    let holds: Vec<[f64; 2]> = trials.iter().map(holds_s).collect();
    let mut usual: Vec<f64> = holds.iter().map(|[usual_s, _]| *usual_s).collect();
    usual.sort_unstable_by(f64::total_cmp);
    let most_s = STUCK * usual[(usual.len() - 1) / 2];
    let is_stuck = |[usual_s, _]: &[f64; 2]| *usual_s > most_s;
    let works = holds.iter().filter(|hold| !is_stuck(hold));
    let [usual_hold_s, longest_hold_s] = works.fold([0.0_f64; 2], |[usual_s, longest_s], hold| {
        [usual_s.max(hold[0]), longest_s.max(hold[1])]
    });
    let stuck = trials.iter().zip(&holds).filter(|(_, hold)| is_stuck(hold));
    let stuck = stuck.map(|(trial, _)| match trial.robot_name() {
        Some(robot) => format!("{}, robot {robot}", trial.path().display()),
        None => trial.path().display().to_string(),
    });
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
        stuck: stuck.collect(),
        v_mps: largest(Column::V),
        omega_radps: largest(Column::Omega),
        voltage_v: voltage().reduce(f64::min).zip(voltage().reduce(f64::max)),
    })
}

/// How long readings of a trial are held, s: the mean, and the longest.
fn holds_s(trial: &Trial) -> [f64; 2] {
    let period_s = trial.period_ns() as f64 * 1e-9;
    let runs = runs(trial);
    let rows: usize = runs.iter().map(|run| run.rows).sum();
    let mean = rows as f64 / runs.len().max(1) as f64;
    let longest = runs.iter().map(|run| run.rows).max().unwrap_or(1);
    [mean * period_s, longest as f64 * period_s]
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
