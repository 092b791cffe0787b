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

/// Makes the profile of trials, one after another.
#[derive(Debug, Default)]
pub struct Profiler {
    readings: Vec<f64>,
    periods: Vec<u64>,
    /// One profile a trial, with the trial's name.
    holds: Vec<([f64; 2], String)>,
    /// Sum of the squared differences of readings, and their number.
    differences: (f64, u64),
    v_mps: Option<f64>,
    omega_radps: Option<f64>,
    voltage_v: Option<(f64, f64)>,
}

impl Profiler {
    /// Takes a trial.
    pub fn take(&mut self, trial: &Trial) {
        self.readings.extend(known(trial, Column::Power));
        self.periods.push(trial.period_ns());
        let file = trial.path().display();
        let name = match trial.robot_name() {
            Some(robot) => format!("{file}, robot {robot}"),
            None => file.to_string(),
        };
        self.holds.push((holds_s(trial), name));
        self.take_differences(trial);
        let larger = |before: Option<f64>, column| {
            let sizes = known(trial, column).map(f64::abs);
            sizes.chain(before).reduce(f64::max)
        };
        self.v_mps = larger(self.v_mps, Column::V);
        self.omega_radps = larger(self.omega_radps, Column::Omega);
        for voltage_v in known(trial, Column::Voltage) {
            let (least, greatest) = self.voltage_v.unwrap_or((voltage_v, voltage_v));
            self.voltage_v = Some((least.min(voltage_v), greatest.max(voltage_v)));
        }
    }

    /// Differences of consecutive readings without a gap between them.
    fn take_differences(&mut self, trial: &Trial) {
        let Some(power) = trial.column(Column::Power) else {
            return;
        };
        let longest_ns = (trial.period_ns() as f64 * MAX_STEP) as i64;
        let steps = trial.offset_ns().windows(2).zip(power.windows(2));
        for (times, readings) in steps {
            let difference = readings[1] - readings[0];
            let step_ns = times[1] - times[0];
            if difference.is_finite() && step_ns > 0 && step_ns <= longest_ns {
                self.differences.0 += difference * difference;
                self.differences.1 += 1;
            }
        }
    }

    /// The profile. `None` if there are fewer than two readings or constant power.
    pub fn finish(self) -> Option<Profile> {
        let Self {
            mut readings,
            mut periods,
            holds,
            differences: (sum, count),
            v_mps,
            omega_radps,
            voltage_v,
        } = self;
        readings.sort_unstable_by(f64::total_cmp);
        let (least, greatest) = (*readings.first()?, *readings.last()?);
        // All of them are finite.
        if least == greatest || count == 0 {
            return None;
        }
        periods.sort_unstable();
        let period_ns = periods[periods.len() / 2];
        let mut usual: Vec<f64> = holds.iter().map(|([usual_s, _], _)| *usual_s).collect();
        usual.sort_unstable_by(f64::total_cmp);
        let most_s = STUCK * usual[(usual.len() - 1) / 2];
        let trials = holds.len();
        let (stuck, works): (Vec<_>, Vec<_>) =
            holds.into_iter().partition(|([usual_s, _], _)| *usual_s > most_s);
        let longest = works.iter().fold([0.0_f64; 2], |[usual_s, longest_s], (hold, _)| {
            [usual_s.max(hold[0]), longest_s.max(hold[1])]
        });
        Some(Profile {
            trials,
            readings: readings.len(),
            rate_hz: 1e9 / period_ns as f64,
            power_w: (least, greatest),
            resolution_w: resolution(&readings),
            difference_w: (sum / count as f64).sqrt(),
            usual_hold_s: longest[0],
            longest_hold_s: longest[1],
            stuck: stuck.into_iter().map(|(_, name)| name).collect(),
            v_mps,
            omega_radps,
            voltage_v,
        })
    }
}

/// Times for which readings of a trial are held, s: the mean, and the longest.
fn holds_s(trial: &Trial) -> [f64; 2] {
    let period_s = trial.period_ns() as f64 * 1e-9;
    let runs = runs(trial);
    let rows: usize = runs.iter().map(|run| run.rows).sum();
    let mean = rows as f64 / runs.len().max(1) as f64;
    let longest = runs.iter().map(|run| run.rows).max().unwrap_or(1);
    [mean * period_s, longest as f64 * period_s]
}

/// The recorded values of a column.
fn known(trial: &Trial, column: Column) -> impl Iterator<Item = f64> {
    let values = trial.column(column).unwrap_or_default().iter().copied();
    values.filter(|value| value.is_finite())
}
