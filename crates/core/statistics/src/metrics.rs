//! Forecast scores, each defined once.
//!
//! A *pair* is a reading and its forecast. Its *residual* is reading minus forecast, as in the live
//! diagnostics. All sums are double precision and in the order of the calls, so the same pairs in
//! the same order give the same bits.
//!
//! **Undefined is visible.** A pair with a reading or a forecast that is not finite enters no score
//! and is counted in [`Tally::unscored`]. An undefined score (no pair, no variance, a zero
//! denominator) is NaN, never 0 or 1.

use serde::{Deserialize, Serialize};

/// Additive sums over parts of a series. One AVX-512 vector.
pub type Additive = [f64; 8];

/// Sums over pairs, from which the scores follow. Tallies of parts can be merged.
///
/// ```
/// use joulebus_statistics::metrics::Tally;
/// let mut tally = Tally::default();
/// for (reading_w, forecast_w) in [(3.0, 3.1), (4.0, 3.9), (5.0, 5.0)] {
///     tally.add(reading_w, forecast_w, 1.0 / 30.0);
/// }
/// assert!((tally.r2() - 0.99).abs() < 1e-12);
/// assert!((tally.mae_w() - 0.2 / 3.0).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Tally {
    count: u64,
    unscored: u64,
    reading_mean_w: f64,
    reading_scatter_w2: f64,
    sum_w: f64,
    sum_abs_w: f64,
    sum_sq_w2: f64,
    relative_count: u64,
    sum_relative: f64,
    reading_j: f64,
    forecast_j: f64,
}

impl Tally {
    /// Adds a pair. `step_s` is the duration of the reading, for the energy. NaN or 0 if the energy
    /// is undefined.
    pub fn add(&mut self, reading_w: f64, forecast_w: f64, step_s: f64) {
        let residual_w = reading_w - forecast_w;
        if !(residual_w.is_finite()) {
            self.unscored += 1;
            return;
        }
        self.count += 1;
        self.sum_w += residual_w;
        self.sum_abs_w += residual_w.abs();
        self.sum_sq_w2 += residual_w * residual_w;
        if reading_w != 0.0 {
            self.relative_count += 1;
            self.sum_relative += (residual_w / reading_w).abs();
        }
        self.reading_j += reading_w * step_s;
        self.forecast_j += forecast_w * step_s;
        let from_mean = reading_w - self.reading_mean_w;
        self.reading_mean_w += from_mean / self.count as f64;
        self.reading_scatter_w2 += from_mean * (reading_w - self.reading_mean_w);
    }

    /// Adds the pairs of another tally. Merging in the same order gives the same bits.
    pub fn merge(&mut self, other: &Self) {
        self.unscored += other.unscored;
        if other.count == 0 {
            return;
        }
        let (own, others) = (self.count as f64, other.count as f64);
        let apart_w = other.reading_mean_w - self.reading_mean_w;
        let share = others / (own + others);
        self.reading_mean_w += apart_w * share;
        self.reading_scatter_w2 += other.reading_scatter_w2 + apart_w * apart_w * own * share;
        self.count += other.count;
        self.sum_w += other.sum_w;
        self.sum_abs_w += other.sum_abs_w;
        self.sum_sq_w2 += other.sum_sq_w2;
        self.relative_count += other.relative_count;
        self.sum_relative += other.sum_relative;
        self.reading_j += other.reading_j;
        self.forecast_j += other.forecast_j;
    }

    /// Plain sums that give the scores, for draws of many tallies, where [`Tally::merge`] would
    /// cost a division each. `centre_w` is a value near the readings.
    pub fn additive(&self, centre_w: f64) -> Additive {
        let count = self.count as f64;
        let apart_w = self.reading_mean_w - centre_w;
        [
            count,
            self.sum_w,
            self.sum_abs_w,
            self.sum_sq_w2,
            count * apart_w,
            self.reading_scatter_w2 + count * apart_w * apart_w,
            self.reading_j,
            self.forecast_j,
        ]
    }

    /// The tally of plain sums about the same centre, without relative residuals and without the
    /// number of unscored pairs.
    pub fn of_additive(sums: &Additive, centre_w: f64) -> Self {
        let [count, sum_w, sum_abs_w, sum_sq_w2, apart_w, squares_w2, reading_j, forecast_j] =
            *sums;
        if count == 0.0 {
            return Self::default();
        }
        let mean_w = apart_w / count;
        let scatter_w2 = squares_w2 - apart_w * mean_w;
        // Rounding leaves less than this of readings that are all equal.
        let varies = scatter_w2 > 1e-13 * squares_w2;
        Self {
            count: count as u64,
            reading_mean_w: centre_w + mean_w,
            reading_scatter_w2: if varies { scatter_w2 } else { 0.0 },
            sum_w,
            sum_abs_w,
            sum_sq_w2,
            reading_j,
            forecast_j,
            ..Self::default()
        }
    }

    /// Sum of the squared differences of the readings from a value, W².
    pub fn squares_about_w2(&self, centre_w: f64) -> f64 {
        let apart_w = self.reading_mean_w - centre_w;
        self.reading_scatter_w2 + self.count as f64 * apart_w * apart_w
    }

    /// Sum of the squared residuals, W².
    pub const fn squared_residuals_w2(&self) -> f64 {
        self.sum_sq_w2
    }

    /// Pairs that were scored.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Pairs not scored because the reading or the forecast was not finite.
    pub const fn unscored(&self) -> u64 {
        self.unscored
    }

    /// Coefficient of determination: 1 − Σ residual² / Σ (reading − mean reading)². At most 1, and
    /// negative if the mean of the readings would have been the better forecast. NaN without a pair
    /// or if all readings are equal.
    pub fn r2(&self) -> f64 {
        one_minus(self.sum_sq_w2, self.reading_scatter_w2)
    }

    /// Root of the mean squared residual, W. NaN without a pair.
    pub fn rmse_w(&self) -> f64 {
        libm::sqrt(self.mse_w2())
    }

    fn mse_w2(&self) -> f64 {
        self.sum_sq_w2 / self.count as f64
    }

    /// Mean absolute residual, W. NaN without a pair.
    pub fn mae_w(&self) -> f64 {
        self.sum_abs_w / self.count as f64
    }

    /// Mean of |residual / reading|, as a share, over the pairs whose reading is not exactly 0. NaN
    /// without such a pair. Readings close to 0 make it large and meaningless.
    pub fn mape(&self) -> f64 {
        self.sum_relative / self.relative_count as f64
    }

    /// Mean residual, W, positive if the forecasts are too low. NaN without a pair.
    pub fn bias_w(&self) -> f64 {
        self.sum_w / self.count as f64
    }

    /// Standard deviation of the residuals about their mean (divided by their number), W. NaN
    /// without a pair.
    pub fn residual_std_w(&self) -> f64 {
        let variance = self.mse_w2() - self.bias_w() * self.bias_w();
        // Rounding alone can make it negative.
        libm::sqrt(if variance < 0.0 { 0.0 } else { variance })
    }

    /// Mean of the readings, W. NaN without a pair.
    pub fn reading_mean_w(&self) -> f64 {
        if self.count == 0 { f64::NAN } else { self.reading_mean_w }
    }

    /// Standard deviation of the readings (divided by their number), W. NaN without a pair.
    pub fn reading_std_w(&self) -> f64 {
        libm::sqrt(self.reading_scatter_w2 / self.count as f64)
    }

    /// Cumulative energy error as a share of the measured energy: (forecast − measured) /
    /// |measured|, each Σ power · step over the scored pairs. Positive if the forecasts are too
    /// high. NaN without a pair, with a step that is NaN, and if no energy was measured.
    pub fn energy_error(&self) -> f64 {
        let measured_j = self.reading_j.abs();
        if measured_j > 0.0 { (self.forecast_j - self.reading_j) / measured_j } else { f64::NAN }
    }

    /// Skill against a baseline: 1 − ratio of the mean squared errors. Positive is better than the
    /// baseline, 1 is perfect. NaN if the baseline has no error, or if the two were scored on
    /// different numbers of pairs and are not comparable.
    pub fn skill(&self, baseline: &Self) -> f64 {
        if self.count == baseline.count {
            one_minus(self.sum_sq_w2, baseline.sum_sq_w2)
        } else {
            f64::NAN
        }
    }
}

/// The tally of two slices of the same length, W, with one step for all pairs, s.
pub fn tally(readings_w: &[f64], forecasts_w: &[f64], step_s: f64) -> Tally {
    let mut tally = Tally::default();
    for (reading_w, forecast_w) in readings_w.iter().zip(forecasts_w) {
        tally.add(*reading_w, *forecast_w, step_s);
    }
    tally
}

/// Sums over intervals and the readings they were made for.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct CoverageTally {
    count: u64,
    unscored: u64,
    below: u64,
    above: u64,
    sum_width_w: f64,
    sum_outside_w: f64,
}

impl CoverageTally {
    /// Adds a reading and its interval, ends included. Where any of the three is not finite, or the
    /// ends are crossed, it is counted as unscored.
    pub fn add(&mut self, reading_w: f64, lo_w: f64, hi_w: f64) {
        let width_w = hi_w - lo_w;
        if !(reading_w.is_finite() && width_w.is_finite() && width_w >= 0.0) {
            self.unscored += 1;
            return;
        }
        self.count += 1;
        self.below += u64::from(reading_w < lo_w);
        self.above += u64::from(reading_w > hi_w);
        self.sum_width_w += width_w;
        self.sum_outside_w += (lo_w - reading_w).max(reading_w - hi_w).max(0.0);
    }

    /// Adds the intervals of another tally.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.unscored += other.unscored;
        self.below += other.below;
        self.above += other.above;
        self.sum_width_w += other.sum_width_w;
        self.sum_outside_w += other.sum_outside_w;
    }

    /// The sums as plain numbers that can be added.
    pub fn additive(&self) -> Additive {
        let counts = [self.count, self.unscored, self.below, self.above];
        let [count, unscored, below, above] = counts.map(|count| count as f64);
        let (width_w, outside_w) = (self.sum_width_w, self.sum_outside_w);
        [count, unscored, below, above, width_w, outside_w, 0.0, 0.0]
    }

    /// The tally of such sums.
    pub fn of_additive(sums: &Additive) -> Self {
        let [count, unscored, below, above, sum_width_w, sum_outside_w, ..] = *sums;
        let [count, unscored, below, above] =
            [count, unscored, below, above].map(|count| count as u64);
        Self { count, unscored, below, above, sum_width_w, sum_outside_w }
    }

    /// Intervals that were scored.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Share of readings inside their interval. NaN without one.
    pub fn coverage(&self) -> f64 {
        (self.count - self.below - self.above) as f64 / self.count as f64
    }

    /// Mean width, W. NaN without an interval.
    pub fn width_w(&self) -> f64 {
        self.sum_width_w / self.count as f64
    }

    /// Mean interval score for a nominal `coverage` of 0 to 1, W: width plus 2 / (1 − coverage)
    /// times the distance of the reading from the interval (Gneiting and Raftery, "Strictly proper
    /// scoring rules", 2007, section 6.2). Smaller is better. It rewards narrow intervals and
    /// penalises misses.
    pub fn score_w(&self, coverage: f64) -> f64 {
        (self.sum_width_w + 2.0 / (1.0 - coverage) * self.sum_outside_w) / self.count as f64
    }

    /// The scores as plain numbers for a nominal coverage of `nominal`.
    pub fn coverage_of(&self, nominal: f64) -> Coverage {
        let share = |count: u64| count as f64 / self.count as f64;
        Coverage {
            count: self.count,
            unscored: self.unscored,
            nominal,
            coverage: self.coverage(),
            below: share(self.below),
            above: share(self.above),
            width_w: self.width_w(),
            score_w: self.score_w(nominal),
        }
    }
}

/// Coverage and width of intervals. Undefined scores are NaN, null in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Coverage {
    /// Readings with an interval.
    pub count: u64,
    /// Readings with no interval or an invalid one.
    pub unscored: u64,
    /// Nominal coverage.
    pub nominal: f64,
    /// Share of readings inside.
    pub coverage: f64,
    /// Share of readings below the lower end.
    pub below: f64,
    /// Share of readings above the upper end.
    pub above: f64,
    /// Mean width, W.
    pub width_w: f64,
    /// Mean interval score, W: smaller is better ([`CoverageTally::score_w`]).
    pub score_w: f64,
}

/// The `share` quantile (0 to 1) of ascending numbers, interpolated linearly between the two
/// nearest at position `share · (n − 1)`. NaN for an empty slice or a share outside 0 to 1.
///
/// The numbers must be finite and in the order of [`f64::total_cmp`], as [`sorted`] returns them.
pub fn quantile(ascending: &[f64], share: f64) -> f64 {
    let Some(last) = ascending.len().checked_sub(1) else {
        return f64::NAN;
    };
    if !(0.0..=1.0).contains(&share) {
        return f64::NAN;
    }
    let place = share * last as f64;
    let below = (place.floor() as usize).min(last);
    let above = (below + 1).min(last);
    let part = place - below as f64;
    ascending[below] + part * (ascending[above] - ascending[below])
}

/// The finite numbers, ascending.
pub fn sorted(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut ascending: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
    ascending.sort_unstable_by(f64::total_cmp);
    ascending
}

/// Quantiles of residuals, W. NaN without residuals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ResidualQuantiles {
    /// Minimum.
    pub min_w: f64,
    /// 5 %.
    pub q05_w: f64,
    /// 25 %.
    pub q25_w: f64,
    /// The median.
    pub q50_w: f64,
    /// 75 %.
    pub q75_w: f64,
    /// 95 %.
    pub q95_w: f64,
    /// Maximum.
    pub max_w: f64,
}

impl ResidualQuantiles {
    /// Quantiles of residuals in any order, W. Those that are not finite are ignored.
    pub fn new(residuals_w: impl IntoIterator<Item = f64>) -> Self {
        Self::of_sorted(&sorted(residuals_w))
    }

    /// Quantiles of ascending, finite residuals, W.
    pub fn of_sorted(ascending: &[f64]) -> Self {
        Self::at_shares(Self::SHARES.map(|share| quantile(ascending, share)))
    }

    /// The probabilities of the quantiles, ascending.
    pub(crate) const SHARES: [f64; 7] = [0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0];

    /// Creates it from the quantiles at [`ResidualQuantiles::SHARES`].
    pub(crate) const fn at_shares(at: [f64; 7]) -> Self {
        let [min_w, q05_w, q25_w, q50_w, q75_w, q95_w, max_w] = at;
        Self { min_w, q05_w, q25_w, q50_w, q75_w, q95_w, max_w }
    }
}

/// Written so that a denominator of 0 or NaN gives NaN.
fn one_minus(error: f64, of: f64) -> f64 {
    if of > 0.0 { 1.0 - error / of } else { f64::NAN }
}
