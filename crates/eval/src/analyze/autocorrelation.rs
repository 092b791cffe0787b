//! Autocorrelation of power readings.

use serde::Serialize;

use joulebus_dataset::trial::{Column, Trial};

/// Autocorrelation of a trial's power readings at lags of 1, 2, … rows.
///
/// At lag k: the mean product of deviations from the trial's mean over all pairs of readings k rows
/// apart without a gap or a missing reading between them, divided by the mean squared deviation of
/// all readings. Without gaps this is the usual estimator times n / (n − k), which removes the bias
/// of short trials towards 0.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Autocorrelation {
    /// At lag 1, 2, …; `None` where there is no pair, or the power is constant.
    pub at_lag: Vec<Option<f64>>,
    /// Pairs at each lag.
    pub pairs: Vec<usize>,
    /// Readings.
    pub readings: usize,
}

/// Autocorrelation at lags from 1 to `lags`.
#[must_use]
pub fn autocorrelation(trial: &Trial, lags: usize) -> Autocorrelation {
    pooled(std::slice::from_ref(trial), lags)
}

/// Autocorrelation over all trials: deviations from the mean of all readings, pairs within trials.
/// It includes the variance between trials, so it exceeds the autocorrelation within a trial;
/// scores over many trials depend on it.
#[must_use]
pub fn pooled(trials: &[Trial], lags: usize) -> Autocorrelation {
    let power_of = |trial| Trial::column(trial, Column::Power).unwrap_or_default();
    let known = || {
        let values = trials.iter().flat_map(power_of);
        values.filter(|value| !value.is_nan())
    };
    let readings = known().count();
    let mean_w = known().sum::<f64>() / readings as f64;
    let square = |value: &f64| (value - mean_w) * (value - mean_w);
    let variance = known().map(square).sum::<f64>() / readings as f64;
    let runs: Vec<&[f64]> = trials.iter().flat_map(runs).collect();
    let mut found = Autocorrelation {
        at_lag: Vec::with_capacity(lags),
        pairs: Vec::with_capacity(lags),
        readings,
    };
    for lag in 1..=lags {
        let (mut sum, mut pairs) = (0.0, 0_usize);
        for run in &runs {
            for (before, after) in run.iter().zip(run.iter().skip(lag)) {
                sum += (before - mean_w) * (after - mean_w);
                pairs += 1;
            }
        }
        let at_lag = sum / pairs as f64 / variance;
        found.at_lag.push(at_lag.is_finite().then_some(at_lag));
        found.pairs.push(pairs);
    }
    found
}

/// Runs of readings without a gap or a missing reading.
fn runs(trial: &Trial) -> Vec<&[f64]> {
    let power_w = trial.column(Column::Power).unwrap_or_default();
    let offset_ns = trial.offset_ns();
    let longest_ns = (trial.period_ns() + trial.period_ns() / 2).cast_signed();
    let mut found: Vec<std::ops::Range<usize>> = Vec::new();
    for (row, value) in power_w.iter().enumerate() {
        if value.is_nan() {
            continue;
        }
        let follows = |last: &std::ops::Range<usize>| {
            last.end == row && (1..=longest_ns).contains(&(offset_ns[row] - offset_ns[row - 1]))
        };
        match found.last_mut() {
            Some(last) if follows(last) => last.end = row + 1,
            _ => found.push(row..row + 1),
        }
    }
    found.into_iter().map(|range| &power_w[range]).collect()
}
