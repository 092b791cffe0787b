//! Sums of each recording.

use joulebus_statistics::metrics::{Additive, CoverageTally, Tally};

/// Sums of one recording.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sums {
    /// Blocks of consecutive rows, in order.
    pub(crate) blocks: Vec<Block>,
    /// Residuals of each forecaster, W. Of scored rows only.
    pub(crate) residuals_w: Vec<Vec<f32>>,
}

/// A block of consecutive rows.
#[derive(Debug, Clone, Default)]
pub(crate) struct Block {
    /// One entry per forecaster: the models, persistence, the linear baselines, the references, the
    /// models' members.
    pub(crate) forecasters: Vec<Tally>,
    /// One entry per model, and per reference with intervals.
    pub(crate) intervals: Vec<CoverageTally>,
}

impl Block {
    fn merge(&mut self, other: &Block) {
        if self.forecasters.is_empty() {
            self.clone_from(other);
            return;
        }
        for (own, other) in self.forecasters.iter_mut().zip(&other.forecasters) {
            own.merge(other);
        }
        for (own, other) in self.intervals.iter_mut().zip(&other.intervals) {
            own.merge(other);
        }
    }

    /// The sum of some blocks, in order.
    pub(crate) fn merged<'a>(blocks: impl IntoIterator<Item = &'a Block>) -> Block {
        let mut merged = Block::default();
        for block in blocks {
            merged.merge(block);
        }
        merged
    }

    /// Joins neighbours in pairs. The last may stay alone.
    pub(crate) fn join_pairs(blocks: &mut Vec<Block>) {
        let pairs = blocks.chunks(2).map(Block::merged);
        *blocks = pairs.collect();
    }
}

/// Blocks for resampling, contiguous in memory.
pub(crate) struct Draws {
    centre_w: f64,
    forecasters: usize,
    /// Tallies of each block: forecasters, then intervals.
    each: usize,
    sums: Vec<Additive>,
}

impl Draws {
    pub(crate) fn new(blocks: &[Block]) -> Self {
        let (forecasters, intervals) = match blocks.first() {
            Some(first) => (first.forecasters.len(), first.intervals.len()),
            None => (0, 0),
        };
        let first = Block::merged(blocks).forecasters.into_iter().next();
        let centre_w = first.map_or(0.0, |tally| tally.reading_mean_w());
        let centre_w = if centre_w.is_finite() { centre_w } else { 0.0 };
        let mut sums = Vec::with_capacity(blocks.len() * (forecasters + intervals));
        for block in blocks {
            sums.extend(block.forecasters.iter().map(|tally| tally.additive(centre_w)));
            sums.extend(block.intervals.iter().map(CoverageTally::additive));
        }
        Self { centre_w, forecasters, each: forecasters + intervals, sums }
    }

    /// The sum of some blocks, possibly repeated.
    pub(crate) fn merged(&self, drawn: &[usize]) -> Block {
        let mut total = vec![[0.0; 8]; self.each];
        for block in drawn {
            let sums = &self.sums[block * self.each..][..self.each];
            for (total, sums) in total.iter_mut().zip(sums) {
                for (total, sum) in total.iter_mut().zip(sums) {
                    *total += sum;
                }
            }
        }
        let (tallies, intervals) = total.split_at(self.forecasters);
        let tally = |sums| Tally::of_additive(sums, self.centre_w);
        Block {
            forecasters: tallies.iter().map(tally).collect(),
            intervals: intervals.iter().map(CoverageTally::of_additive).collect(),
        }
    }
}
