//! Confidence intervals of scores by block bootstrap.
//!
//! Neighbouring rows are correlated, so single rows are never resampled. Whole blocks are drawn
//! with replacement, as many as there are, and the score is recomputed from each draw. The interval
//! spans the middle share of these scores (Carlstein, "The use of subseries values for estimating
//! the variance", 1986; Efron's percentile interval). Scores that are compared use the same draws,
//! so that their common variance cancels.
//!
//! The intervals do not cover robots or surfaces without a block.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::metrics::{quantile, sorted};
use crate::noise::Noise;

/// Minimum number of blocks for an interval: with fewer, the draws repeat each other.
pub const MIN_BLOCKS: usize = 8;

/// Configuration of the bootstrap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bootstrap {
    /// Number of draws. 0 disables intervals.
    pub resamples: u32,
    /// Confidence level, above 0 and below 1.
    pub confidence: f64,
    /// Seed of the draws.
    pub seed: u64,
    /// Rows per block if blocks are not whole trials, at least 1.
    pub block_rows: usize,
    /// Minimum number of trials at which a block is a whole trial.
    pub trials_from: usize,
}

impl Default for Bootstrap {
    /// 1,000 draws, 95 %, blocks of 50 rows (1.7 s at 30 Hz), whole trials from 20 on.
    fn default() -> Self {
        Self { resamples: 1000, confidence: 0.95, seed: 0, block_rows: 50, trials_from: 20 }
    }
}

/// A score and its confidence interval, in the score's own unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The score of the whole.
    pub value: f64,
    /// Lower end. NaN (null in JSON) with too few blocks or when a draw has no score.
    pub lo: f64,
    /// Upper end, like the lower.
    pub hi: f64,
}

impl Estimate {
    /// A score without an interval.
    pub const fn alone(value: f64) -> Self {
        Self { value, lo: f64::NAN, hi: f64::NAN }
    }

    /// The interval of a mean of `count` draws, widened as Student's distribution is wider than the
    /// normal one: a bootstrap of few draws understates their spread. By the first terms of its
    /// expansion, at 95 %.
    #[must_use]
    pub fn widened_for(self, count: usize) -> Self {
        const SQUARE: f64 = 1.96 * 1.96;
        let freedom = count.saturating_sub(1).max(1) as f64;
        let spread = ((freedom + 1.0) / freedom).sqrt();
        let wider = spread * (1.0 + (SQUARE + 1.0) / (4.0 * freedom));
        let from_value = |end: f64| self.value + wider * (end - self.value);
        Self { lo: from_value(self.lo), hi: from_value(self.hi), ..self }
    }

    /// True if the whole interval is above `bound`.
    pub fn is_above(&self, bound: f64) -> bool {
        self.lo > bound
    }

    /// True if the whole interval is below `bound`.
    pub fn is_below(&self, bound: f64) -> bool {
        self.hi < bound
    }
}

impl Bootstrap {
    /// `statistics(blocks)` computes any number of scores from blocks `0..count`, given by index,
    /// possibly repeated. It is called once with every block for the values and once per draw for
    /// the intervals. Draws run in parallel. The result has the same bits for any number of
    /// threads.
    pub fn estimate<S>(&self, count: usize, statistics: S) -> Vec<Estimate>
    where
        S: Fn(&[usize]) -> Vec<f64> + Sync,
    {
        let each_once: Vec<usize> = (0..count).collect();
        let values = statistics(&each_once).into_iter().map(Estimate::alone);
        let mut estimates: Vec<Estimate> = values.collect();
        if count < MIN_BLOCKS || self.resamples == 0 {
            return estimates;
        }
        let drawn: Vec<Vec<f64>> = (0..self.resamples)
            .into_par_iter()
            .map_init(
                || vec![0; count],
                |blocks, draw| {
                    let mut noise = Noise::new(self.seed, u64::from(draw));
                    blocks.fill_with(|| noise.below(count));
                    statistics(blocks)
                },
            )
            .collect();
        for (at, estimate) in estimates.iter_mut().enumerate() {
            let ascending = sorted(drawn.iter().map(|scores| scores[at]));
            if ascending.len() == drawn.len() {
                let tail = 0.5 * (1.0 - self.confidence);
                estimate.lo = quantile(&ascending, tail);
                estimate.hi = quantile(&ascending, 1.0 - tail);
            }
        }
        estimates
    }
}
