//! A platform's profile from recordings: rate, ranges, resolution, holds, and steps of the
//! readings.

use serde::Serialize;

use super::hold::runs;
use crate::trial::{Column, Trial};

/// Share of the readings that must lie on a grid for its step to be the resolution.
const ON_GRID: f64 = 0.95;
/// Distance from the grid that counts as on it, steps.
const NEAR_GRID: f64 = 0.05;
/// Steps that are tried, from the quantiles of the gaps between readings.
const CANDIDATES: usize = 40;
/// Number of different readings that is too small to infer their step.
const FEW_VALUES: usize = 10;
/// Maximum number of steps from the lowest to the highest reading. A finer grid is due to the
/// file's decimals.
const MAX_STEPS: f64 = 2e4;
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
#[must_use]
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
        resolution_w: resolution(readings),
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

/// The largest step such that nearly all readings differ by multiples of it.
fn resolution(mut sorted: Vec<f64>) -> Option<f64> {
    sorted.dedup();
    if sorted.len() <= FEW_VALUES {
        return None;
    }
    let mut gaps: Vec<f64> = sorted.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_unstable_by(f64::total_cmp);
    let last = gaps.len() - 1;
    // Recorded numbers are rounded, so the smallest gap may be due to rounding.
    let candidates = (0..=CANDIDATES)
        .rev()
        .map(|nth| gaps[last * nth / CANDIDATES]);
    candidates.filter_map(|step| grid(&sorted, step)).next()
}

/// The exact step, if nearly all values are whole steps above the first.
fn grid(sorted: &[f64], step: f64) -> Option<f64> {
    let start = *sorted.first()?;
    let span = *sorted.last()? - start;
    if !(step > 0.0 && span / step < MAX_STEPS) {
        return None;
    }
    let (mut exact, mut on_grid) = (step, 0);
    for value in sorted {
        let steps = (value - start) / exact;
        if (steps - steps.round()).abs() <= NEAR_GRID {
            on_grid += 1;
            // The further from the start, the more exact.
            if steps.round() >= 1.0 {
                exact = (value - start) / steps.round();
            }
        }
    }
    (f64::from(on_grid) / sorted.len() as f64 >= ON_GRID).then_some(exact)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_is_found_and_a_continuum_has_none() {
        let grid = (0..200)
            .map(|step| 3.0 + 0.01 * f64::from(step * 7 % 101))
            .collect();
        let mut grid: Vec<f64> = grid;
        grid.sort_unstable_by(f64::total_cmp);
        let step = resolution(grid).expect("a grid");
        assert!((step - 0.01).abs() < 1e-9, "{step}");
        // Steps of 615.38 mW in a file of two decimals.
        let mut rounded: Vec<f64> = (0..400)
            .map(|at| {
                let exact = f64::from(at % 61) * 0.615_384_6 + f64::from(at % 3) * 1e-5;
                (exact * 1e5).round() / 1e5
            })
            .collect();
        rounded.sort_unstable_by(f64::total_cmp);
        let step = resolution(rounded).expect("a grid");
        assert!((step - 0.615_384_6).abs() < 1e-4, "{step}");
        let mut smooth: Vec<f64> = (0..200).map(|at| f64::from(at).sqrt()).collect();
        smooth.sort_unstable_by(f64::total_cmp);
        assert_eq!(resolution(smooth), None);
    }
}
