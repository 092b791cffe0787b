//! Distribution of the repetitions of one measurement.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

/// Distribution of one figure over its repetitions, in the figure's unit.
///
/// Quantiles are nearest ranks: each is a measured value. Below 1000 repetitions `p999` is the
/// maximum, below 100 `p99` is too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distribution {
    /// Repetitions.
    pub count: u64,
    /// Minimum.
    pub min: f64,
    /// First quartile.
    pub p25: f64,
    /// Median.
    pub p50: f64,
    /// Third quartile.
    pub p75: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Maximum.
    pub max: f64,
}

impl Distribution {
    /// The distribution of measured values. `None` if there are none, or if one is not finite.
    pub fn new(values: &[f64]) -> Option<Self> {
        if values.is_empty() || !values.iter().all(|value| value.is_finite()) {
            return None;
        }
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |quantile: f64| {
            let rank = (quantile * sorted.len() as f64).ceil() as usize;
            sorted[rank.clamp(1, sorted.len()) - 1]
        };
        Some(Self {
            count: sorted.len() as u64,
            min: at(0.0),
            p25: at(0.25),
            p50: at(0.5),
            p75: at(0.75),
            p99: at(0.99),
            p999: at(0.999),
            max: at(1.0),
        })
    }

    /// The distribution of a histogram, each value times `scale`. `None` if it is empty.
    pub fn of_histogram(histogram: &Histogram<u64>, scale: f64) -> Option<Self> {
        let at = |quantile| histogram.value_at_quantile(quantile) as f64 * scale;
        (!histogram.is_empty()).then(|| Self {
            count: histogram.len(),
            min: histogram.min() as f64 * scale,
            p25: at(0.25),
            p50: at(0.5),
            p75: at(0.75),
            p99: at(0.99),
            p999: at(0.999),
            max: histogram.max() as f64 * scale,
        })
    }

    /// The distribution of one value, measured or counted once.
    pub fn once(value: f64) -> Option<Self> {
        Self::new(&[value])
    }

    /// True if the interquartile ranges are disjoint, so that the difference exceeds noise.
    pub fn differs_from(&self, other: &Self) -> bool {
        self.p25 > other.p75 || other.p25 > self.p75
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_measured_values() {
        let values: Vec<f64> = (1..=1000).rev().map(f64::from).collect();
        let all = Distribution::new(&values).expect("there are values");
        let found = [all.min, all.p25, all.p50, all.p75, all.p99, all.p999, all.max];
        assert_eq!(found, [1.0, 250.0, 500.0, 750.0, 990.0, 999.0, 1000.0]);
        let one = Distribution::once(7.0).expect("there is a value");
        assert_eq!((one.count, one.min, one.p999, one.max), (1, 7.0, 7.0, 7.0));
    }

    #[test]
    fn no_values_or_values_that_are_not_finite_give_no_figure() {
        assert_eq!(Distribution::new(&[]), None);
        assert_eq!(Distribution::new(&[1.0, f64::NAN]), None);
        assert_eq!(Distribution::once(f64::INFINITY), None);
    }

    #[test]
    fn a_histogram_gives_the_same_as_its_values() {
        let mut histogram = crate::histogram();
        let values: Vec<f64> = (1..=100).map(f64::from).collect();
        for value in &values {
            histogram.saturating_record(*value as u64);
        }
        let (binned, exact) =
            (Distribution::of_histogram(&histogram, 1.0), Distribution::new(&values));
        assert_eq!(binned, exact);
    }

    #[test]
    fn touching_interquartile_ranges_do_not_differ() {
        let of = |from: i32, to: i32| {
            let values: Vec<f64> = (from..=to).map(f64::from).collect();
            Distribution::new(&values).expect("there are values")
        };
        assert!(!of(0, 100).differs_from(&of(50, 150)));
        assert!(of(0, 100).differs_from(&of(80, 180)));
        assert!(of(80, 180).differs_from(&of(0, 100)));
    }
}
