//! How far a score is to be trusted: confidence intervals by block bootstrap.
//!
//! Neighbouring rows know each other's answers, so rows are never drawn one by one: whole blocks
//! are, with replacement, as many as there are, and the score is recomputed from each draw; the
//! interval holds the middle share of what came out (Carlstein, "The use of subseries values for
//! estimating the variance", 1986; the percentile interval of Efron). Scores that are compared are
//! computed from the same draws, so that what is common to them cancels.
//!
//! What it does not tell: how the model would do on robots or surfaces of which there is no block.

use rayon::prelude::*;
use serde::Serialize;

use crate::metrics::{quantile, sorted};
use crate::noise::Noise;

/// Least blocks for an interval: of fewer, the draws repeat each other.
pub const LEAST_BLOCKS: usize = 8;

/// How intervals are made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bootstrap {
    /// Draws; 0 for no intervals.
    pub resamples: u32,
    /// Share of the draws inside the interval, above 0 and below 1.
    pub confidence: f64,
    /// Seed of the draws.
    pub seed: u64,
    /// Rows of a block, where blocks are not whole trials; at least 1.
    pub block_rows: usize,
    /// From so many trials on, a block is a whole trial.
    pub trials_from: usize,
}

impl Default for Bootstrap {
    /// 1,000 draws, 95 %, blocks of 50 rows (1.7 s at 30 Hz), whole trials from 20 on.
    fn default() -> Self {
        Self {
            resamples: 1000,
            confidence: 0.95,
            seed: 0,
            block_rows: 50,
            trials_from: 20,
        }
    }
}

/// A score and its confidence interval, in the score's own unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The score of the whole.
    pub value: f64,
    /// Lower end; NaN, in JSON null, where there are too few blocks or a draw has no score.
    pub lo: f64,
    /// Upper end, as the lower.
    pub hi: f64,
}

impl Estimate {
    /// A score of which nothing more is known.
    #[must_use]
    pub const fn alone(value: f64) -> Self {
        Self {
            value,
            lo: f64::NAN,
            hi: f64::NAN,
        }
    }

    /// Whether the whole interval lies above `bound`.
    #[must_use]
    pub fn is_above(&self, bound: f64) -> bool {
        self.lo > bound
    }

    /// Whether the whole interval lies below `bound`.
    #[must_use]
    pub fn is_below(&self, bound: f64) -> bool {
        self.hi < bound
    }
}

impl Bootstrap {
    /// `statistics(blocks)` computes any number of scores from blocks `0..count` given by number,
    /// some of them more than once. It is called with each block once for the values, and with
    /// every draw for the intervals; draws are shared among threads, and the result has the same
    /// bits for any number of them.
    pub fn estimate<S>(&self, count: usize, statistics: S) -> Vec<Estimate>
    where
        S: Fn(&[usize]) -> Vec<f64> + Sync,
    {
        let each_once: Vec<usize> = (0..count).collect();
        let values = statistics(&each_once).into_iter().map(Estimate::alone);
        let mut estimates: Vec<Estimate> = values.collect();
        if count < LEAST_BLOCKS || self.resamples == 0 {
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
