//! Distribution of the repetitions of one measurement.

use hdrhistogram::Histogram;
use serde::Serialize;

/// Distribution of one figure over its repetitions, in the figure's unit.
///
/// Quantiles are nearest ranks: each is a measured value. Below 1000 repetitions `p999` is the
/// maximum, below 100 `p99` is too.
#[allow(missing_docs, reason = "the names are those of the quantiles")]
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distribution {
    pub count: u64,
    pub min: f64,
    pub p25: f64,
    pub p50: f64,
    pub p75: f64,
    pub p99: f64,
    pub p999: f64,
    pub max: f64,
}

impl Distribution {
    fn quantiles(count: u64, at: impl Fn(f64) -> f64) -> Self {
        let [min, p25, p50, p75, p99, p999, max] = [0.0, 0.25, 0.5, 0.75, 0.99, 0.999, 1.0].map(at);
        Self { count, min, p25, p50, p75, p99, p999, max }
    }

    /// The distribution of measured values. `None` if there are none, or if one is not finite.
    pub fn new(values: &[f64]) -> Option<Self> {
        if values.is_empty() || !values.iter().all(|value| value.is_finite()) {
            return None;
        }
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let rank = |quantile: f64| (quantile * sorted.len() as f64).ceil() as usize;
        let at = |quantile| sorted[rank(quantile).clamp(1, sorted.len()) - 1];
        Some(Self::quantiles(sorted.len() as u64, at))
    }

    /// The distribution of a histogram, each value times `scale`. `None` if it is empty.
    pub fn of_histogram(histogram: &Histogram<u64>, scale: f64) -> Option<Self> {
        let at = |quantile| histogram.value_at_quantile(quantile) as f64 * scale;
        (!histogram.is_empty()).then(|| Self::quantiles(histogram.len(), at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_measured_values_and_those_of_a_histogram() {
        let values: Vec<f64> = (1..=1000).rev().map(f64::from).collect();
        let all = Distribution::new(&values).expect("there are values");
        let found = [all.min, all.p25, all.p50, all.p75, all.p99, all.p999, all.max];
        assert_eq!(found, [1.0, 250.0, 500.0, 750.0, 990.0, 999.0, 1000.0]);
        let mut histogram = crate::histogram();
        for value in &values {
            histogram.saturating_record(*value as u64);
        }
        assert_eq!(Distribution::of_histogram(&histogram, 1.0), Some(all));
    }

    #[test]
    fn no_values_or_values_that_are_not_finite_give_no_figure() {
        for values in [&[][..], &[1.0, f64::NAN], &[f64::INFINITY]] {
            assert_eq!(Distribution::new(values), None, "{values:?}");
        }
    }
}
