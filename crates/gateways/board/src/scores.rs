//! Scores of the forecasts of the whole fleet, from what a planner receives.

use joulebus_wire::{Diagnostic, Forecast, diagnostic_flag, forecast_flag};
use serde::Serialize;

/// Sums over all readings whose forecast this planner has received.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Pooled {
    count: u64,
    sum_sq_w2: f64,
    persistence_sum_sq_w2: f64,
    mean_w: f64,
    scatter_w2: f64,
}

impl Pooled {
    /// Adds two successive outputs of one robot. They count if the later output's reading is that
    /// of the sample directly after the one that the earlier output answers. Returns the reading
    /// minus its forecast, W.
    pub(crate) fn observe(&mut self, before: &Forecast, after: &Forecast) -> Option<f64> {
        let (residual_w, step_w) = residual(before, after)?;
        let reading_w = f64::from(after.reading_w);
        self.count += 1;
        self.sum_sq_w2 += residual_w * residual_w;
        self.persistence_sum_sq_w2 += step_w * step_w;
        let from_mean = reading_w - self.mean_w;
        self.mean_w += from_mean / self.count as f64;
        self.scatter_w2 += from_mean * (reading_w - self.mean_w);
        Some(residual_w)
    }
}

/// Reading minus forecast, and reading minus previous reading, W.
fn residual(before: &Forecast, after: &Forecast) -> Option<(f64, f64)> {
    let read = forecast_flag::READING | forecast_flag::SAMPLE;
    let follows = before.flags & read == read
        && after.flags & read == read
        && before.source_epoch == after.source_epoch
        && before.generation == after.generation
        && before.sample_seq.checked_add(1) == Some(after.sample_seq);
    let forecast_w = before.expected_w().filter(|_| follows)?;
    let reading_w = f64::from(after.reading_w);
    Some((reading_w - f64::from(forecast_w), reading_w - f64::from(before.reading_w)))
}

/// Scores of a fleet. Unknown values are `None`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Scores {
    /// Readings scored by the worker, all robots.
    pub scored: u64,
    /// Root mean squared error of the forecasts over all readings received by this planner, W.
    pub rmse_w: Option<f64>,
    /// RMSE of persistence (forecast = last reading), W.
    pub persistence_rmse_w: Option<f64>,
    /// Mean absolute error of the forecasts over all readings, W.
    pub mae_w: Option<f64>,
    /// MAE of persistence, W.
    pub persistence_mae_w: Option<f64>,
    /// Fraction of the robots whose squared error is below that of persistence.
    pub better_than_persistence: Option<f64>,
    /// Coefficient of determination over all readings received by this planner.
    pub r2: Option<f64>,
    /// R² of persistence.
    pub persistence_r2: Option<f64>,
    /// Median over the robots of their mean absolute errors, W.
    pub median_mae_w: Option<f64>,
    /// Median MAE of persistence, W.
    pub median_persistence_mae_w: Option<f64>,
    /// Median over the robots of their coefficients of determination.
    pub median_r2: Option<f64>,
    /// Median R² of persistence.
    pub median_persistence_r2: Option<f64>,
    /// Fraction of readings inside the interval of their forecast.
    pub coverage: Option<f64>,
}

impl Scores {
    /// Computed from the newest diagnostics of all robots and the planner's own sums.
    pub(crate) fn of<'a>(
        diagnostics: impl Iterator<Item = &'a Diagnostic>,
        pooled: &Pooled,
    ) -> Self {
        let scored: Vec<&Diagnostic> = diagnostics
            .filter(|diagnostic| diagnostic.flags & diagnostic_flag::SCORES != 0)
            .collect();
        let count: u64 = scored.iter().map(|diagnostic| diagnostic.scored).sum();
        let mean = |value: fn(&Diagnostic) -> f64| {
            let sum: f64 =
                scored.iter().map(|diagnostic| value(diagnostic) * diagnostic.scored as f64).sum();
            known(sum / count as f64)
        };
        let middle = |value: fn(&Diagnostic) -> f64| {
            median(scored.iter().map(|diagnostic| value(diagnostic)).collect())
        };
        let better = scored.iter().filter(|diagnostic| diagnostic.r2 > diagnostic.persistence_r2);
        let root = |error: f64| known((error / pooled.count as f64).sqrt());
        let explained = |error: f64| known(1.0 - error / pooled.scatter_w2);
        Self {
            scored: count,
            rmse_w: root(pooled.sum_sq_w2),
            persistence_rmse_w: root(pooled.persistence_sum_sq_w2),
            mae_w: mean(|diagnostic| diagnostic.mae_w),
            persistence_mae_w: mean(|diagnostic| diagnostic.persistence_mae_w),
            better_than_persistence: known(better.count() as f64 / scored.len() as f64),
            r2: explained(pooled.sum_sq_w2),
            persistence_r2: explained(pooled.persistence_sum_sq_w2),
            median_mae_w: middle(|diagnostic| diagnostic.mae_w),
            median_persistence_mae_w: middle(|diagnostic| diagnostic.persistence_mae_w),
            median_r2: middle(|diagnostic| diagnostic.r2),
            median_persistence_r2: middle(|diagnostic| diagnostic.persistence_r2),
            coverage: mean(|diagnostic| f64::from(diagnostic.coverage)),
        }
    }
}

/// The value, or none if it is not a number.
pub(crate) fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    let upper = *values.get(middle)?;
    Some(if values.len() % 2 == 1 { upper } else { 0.5 * (values[middle - 1] + upper) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn output(seq: u64, reading_w: f32, power_w: f32) -> Forecast {
        Forecast {
            flags: forecast_flag::POWER | forecast_flag::READING | forecast_flag::SAMPLE,
            sample_seq: seq,
            reading_w,
            power_w,
            ..Forecast::default()
        }
    }

    #[test]
    fn fleet_r2_equals_the_two_pass_formula_and_gaps_are_excluded() {
        let outputs = [
            output(0, 3.0, 4.0),
            output(1, 4.0, 4.5),
            output(2, 5.0, 5.0),
            output(4, 9.0, 9.0),
            output(5, 7.0, 7.0),
        ];
        let mut pooled = Pooled::default();
        for pair in outputs.windows(2) {
            pooled.observe(&pair[0], &pair[1]);
        }
        let scores = Scores::of([].iter(), &pooled);
        // Readings 4, 5, 7 with residuals 0, 0.5, -2 and steps 1, 1, -2.
        let scatter = (16.0 + 25.0 + 49.0) - 256.0 / 3.0;
        assert_eq!(pooled.count, 3);
        assert!((scores.r2.unwrap() - (1.0 - 4.25 / scatter)).abs() < 1e-12);
        assert!((scores.persistence_r2.unwrap() - (1.0 - 6.0 / scatter)).abs() < 1e-12);
        assert!((scores.rmse_w.unwrap() - (4.25f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((scores.persistence_rmse_w.unwrap() - 2f64.sqrt()).abs() < 1e-12);
        assert_eq!(scores.mae_w, None);
        assert_eq!(scores.better_than_persistence, None);
    }

    #[test]
    fn the_mean_weights_robots_by_readings_and_median_and_share_equally() {
        let diagnostic = |scored, mae_w, r2| Diagnostic {
            flags: if scored > 0 { diagnostic_flag::SCORES } else { 0 },
            scored,
            mae_w,
            r2,
            persistence_r2: 0.6,
            ..Diagnostic::default()
        };
        let fleet = [
            diagnostic(10, 1.0, 0.5),
            diagnostic(30, 2.0, f64::NAN),
            diagnostic(0, f64::NAN, f64::NAN),
            diagnostic(10, 6.0, 0.7),
        ];
        let scores = Scores::of(fleet.iter(), &Pooled::default());
        assert_eq!(scores.scored, 50);
        assert_eq!(scores.mae_w, Some(2.6));
        assert_eq!(scores.median_mae_w, Some(2.0));
        assert_eq!(scores.better_than_persistence, Some(1.0 / 3.0));
        assert_eq!(scores.median_r2, Some(0.6));
        assert_eq!((scores.r2, scores.rmse_w), (None, None));
    }
}
