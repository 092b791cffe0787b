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
    /// The values at lag 1, 2, …. `None` if there is no pair, or the power is constant.
    pub at_lag: Vec<Option<f64>>,
    /// Pairs at each lag.
    pub pairs: Vec<usize>,
    /// Readings.
    pub readings: usize,
}

/// Autocorrelation at lags from 1 to `lags`.
pub fn autocorrelation(trial: &Trial, lags: usize) -> Autocorrelation {
    LagSums::new(trial, lags).alone()
}

/// Autocorrelation over all trials: deviations from the mean of all readings, pairs within trials.
/// It includes the variance between trials, so it exceeds the autocorrelation within a trial.
/// Scores over many trials depend on it.
pub fn pooled(trials: &[Trial], lags: usize) -> Autocorrelation {
    let each = trials.iter().map(|trial| LagSums::new(trial, lags));
    LagSums::pooled(&each.collect::<Vec<_>>(), lags)
}

/// Sums over one trial's readings. They give its autocorrelation and that of several trials.
#[derive(Debug, Clone)]
pub(super) struct LagSums {
    readings: usize,
    /// Mean of the readings. Deviations are from it. 0 without a reading.
    mean_w: f64,
    sum_w: f64,
    sum_squares_w2: f64,
    /// At lag 1, 2, …
    lags: Vec<Pairs>,
}

/// Pairs of readings at a lag.
#[derive(Debug, Clone, Copy, Default)]
struct Pairs {
    count: usize,
    /// Sum of the products of their deviations.
    sum_w2: f64,
    /// Sum of both deviations.
    sum_w: f64,
}

impl LagSums {
    pub(super) fn new(trial: &Trial, lags: usize) -> Self {
        let power_w = trial.column(Column::Power).unwrap_or_default();
        let known = || power_w.iter().copied().filter(|value| !value.is_nan());
        let readings = known().count();
        let mean_w = known().sum::<f64>() / readings.max(1) as f64;
        let runs = runs(trial);
        let pairs = |lag: usize| {
            let mut pairs = Pairs::default();
            for run in &runs {
                for (before, after) in run.iter().zip(run.iter().skip(lag)) {
                    pairs.sum_w2 += (before - mean_w) * (after - mean_w);
                    pairs.sum_w += (before - mean_w) + (after - mean_w);
                    pairs.count += 1;
                }
            }
            pairs
        };
        Self {
            readings,
            mean_w,
            sum_w: known().map(|value| value - mean_w).sum(),
            sum_squares_w2: known().map(|value| (value - mean_w) * (value - mean_w)).sum(),
            lags: (1..=lags).map(pairs).collect(),
        }
    }

    pub(super) const fn readings(&self) -> usize {
        self.readings
    }

    /// About the trial's own mean.
    pub(super) fn alone(&self) -> Autocorrelation {
        let variance = self.sum_squares_w2 / self.readings as f64;
        Autocorrelation {
            at_lag: self
                .lags
                .iter()
                .map(|pairs| known(pairs.sum_w2 / pairs.count as f64 / variance))
                .collect(),
            pairs: self.lags.iter().map(|pairs| pairs.count).collect(),
            readings: self.readings,
        }
    }

    /// About the mean of all readings of some trials.
    pub(super) fn pooled(all: &[Self], lags: usize) -> Autocorrelation {
        let readings: usize = all.iter().map(|one| one.readings).sum();
        let mean_w =
            all.iter().map(|one| one.mean_w * one.readings as f64).sum::<f64>() / readings as f64;
        // Deviations from another mean, `apart_w` below the trial's own.
        let squares = all.iter().map(|one| {
            let apart_w = one.mean_w - mean_w;
            one.sum_squares_w2 + apart_w * (2.0 * one.sum_w + one.readings as f64 * apart_w)
        });
        let variance = squares.sum::<f64>() / readings as f64;
        let at_lag = |lag: usize| {
            let of_lag = || all.iter().map(|one| (one.mean_w - mean_w, one.lags[lag]));
            let sums = of_lag().map(|(apart_w, pairs)| {
                pairs.sum_w2 + apart_w * (pairs.sum_w + pairs.count as f64 * apart_w)
            });
            let count: usize = of_lag().map(|(_, pairs)| pairs.count).sum();
            (known(sums.sum::<f64>() / count as f64 / variance), count)
        };
        let (at_lag, pairs) = (0..lags).map(at_lag).unzip();
        Autocorrelation { at_lag, pairs, readings }
    }
}

fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
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
