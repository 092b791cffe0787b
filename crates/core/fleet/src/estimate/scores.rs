//! Running scores of the forecasts and of persistence.

use joulebus_predictor::nan::canonical_f64;
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{Count, block};

block! {
    /// Running scores of one robot. Sums in `f64`, in the order of its samples.
    #[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
    pub struct Scores;

    /// The scores of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(64))]
    pub(crate) struct ScoreLanes {
        /// Readings scored.
        pub count: Count,
        sum_abs_w: f64,
        sum_sq_w2: f64,
        persistence_sum_abs_w: f64,
        persistence_sum_sq_w2: f64,
        mean_w: f64,
        scatter_w2: f64,
    }
}

impl Scores {
    /// Records a reading, the residual of its forecast, and the reading before it.
    #[inline(always)]
    pub fn observe(&mut self, reading_w: f32, residual_w: f32, previous_w: f32) {
        let (reading, residual) = (f64::from(reading_w), f64::from(residual_w));
        let step = reading - f64::from(previous_w);
        self.count += 1;
        self.sum_abs_w += residual.abs();
        self.sum_sq_w2 += residual * residual;
        self.persistence_sum_abs_w += step.abs();
        self.persistence_sum_sq_w2 += step * step;
        let from_mean = reading - self.mean_w;
        self.mean_w += from_mean / self.count as f64;
        self.scatter_w2 += from_mean * (reading - self.mean_w);
    }

    /// Share of one reading. Infinite before the first. A division takes as long as all else that
    /// is done with it, here and below.
    #[inline(always)]
    pub(crate) fn share(&self) -> f64 {
        1.0 / self.count as f64
    }

    /// Mean absolute residual, W. NaN before the first.
    #[inline(always)]
    pub fn mae_w(&self) -> f64 {
        canonical_f64(self.sum_abs_w * self.share())
    }

    /// Coefficient of determination of the forecasts. NaN for constant readings.
    #[inline(always)]
    pub fn r2(&self) -> f64 {
        explained(self.sum_sq_w2, self.scatter_w2)
    }

    /// Mean absolute error of persistence, W. NaN before the first.
    #[inline(always)]
    pub fn persistence_mae_w(&self) -> f64 {
        canonical_f64(self.persistence_sum_abs_w * self.share())
    }

    /// Coefficient of determination of persistence. NaN for constant readings.
    #[inline(always)]
    pub fn persistence_r2(&self) -> f64 {
        explained(self.persistence_sum_sq_w2, self.scatter_w2)
    }

    /// 1 − ratio of the squared error to persistence's. NaN for constant readings.
    #[inline(always)]
    pub fn skill(&self) -> f64 {
        explained(self.sum_sq_w2, self.persistence_sum_sq_w2)
    }
}

#[inline(always)]
fn explained(error: f64, of: f64) -> f64 {
    let explained = 1.0 - error * (1.0 / of);
    // Infinite sums have no ratio.
    canonical_f64(if of > 0.0 { explained } else { f64::NAN })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn running_scores_equal_the_two_pass_formulas(
            rows in prop::collection::vec((3.0f32..9.0, -0.5f32..0.5), 3..300)
        ) {
            let mut scores = Scores::default();
            let readings: Vec<f64> = rows.iter().map(|row| f64::from(row.0)).collect();
            for pair in rows.windows(2) {
                scores.observe(pair[1].0, pair[1].1, pair[0].0);
            }
            let scored = &readings[1..];
            let n = scored.len() as f64;
            let mean = scored.iter().sum::<f64>() / n;
            let total: f64 = scored.iter().map(|y| (y - mean).powi(2)).sum();
            let error: f64 = rows[1..].iter().map(|row| f64::from(row.1).powi(2)).sum();
            let steps: f64 = readings.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
            prop_assert_eq!(scores.count, scored.len() as u64);
            if total > 1e-6 && steps > 1e-6 {
                prop_assert!((scores.r2() - (1.0 - error / total)).abs() < 1e-9 * (1.0 + error / total));
                prop_assert!((scores.persistence_r2() - (1.0 - steps / total)).abs() < 1e-9 * (1.0 + steps / total));
                prop_assert!((scores.skill() - (1.0 - error / steps)).abs() < 1e-9 * (1.0 + error / steps));
            }
        }
    }

    #[test]
    fn nothing_scored_is_not_a_number() {
        let mut scores = Scores::default();
        for infinite in [false, true] {
            let [mae_w, r2] = [scores.mae_w(), scores.r2()];
            let [persistence_mae_w, persistence_r2] =
                [scores.persistence_mae_w(), scores.persistence_r2()];
            let found = [mae_w, persistence_mae_w, r2, persistence_r2, scores.skill()];
            for value in found.into_iter().skip(if infinite { 2 } else { 0 }) {
                assert_eq!(value.to_bits(), f64::NAN.to_bits(), "{found:?}");
            }
            scores.count = 1;
            (scores.sum_sq_w2, scores.scatter_w2) = (f64::INFINITY, f64::INFINITY);
            scores.persistence_sum_sq_w2 = f64::INFINITY;
        }
    }
}
