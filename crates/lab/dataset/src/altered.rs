//! Recognises altered copies of recordings: scaled, reversed, or with every n-th reading.
//!
//! Ratios of consecutive readings are compared, to 9 bits of their mantissa, because a factor does
//! not change them. A match of a block may be chance for robots that repeat a motion, so only the
//! share of a whole recording tells something.

use std::collections::HashSet;

use crate::rows::Row;
use crate::trained_rows::{Sums, mixed, runs};

/// Ratios of a block, and the fewest changes among them that tell it from others.
const BLOCK: usize = 32;
const FEWEST_CHANGES: usize = 24;
/// Recordings with every reading to every fourth one of another are recognised.
const MAX_STRIDE: usize = 4;

/// The shapes of some recordings' power: hashes of blocks of ratios.
#[derive(Debug, Clone, Default)]
pub struct Shapes(HashSet<u64>);

impl Shapes {
    /// Adds those of some rows, and of every second to fourth of them.
    pub fn add(&mut self, rows: &[Row]) {
        for run in runs(rows) {
            for (stride, offset) in strides() {
                let ratios = ratios(run.iter().skip(offset).step_by(stride));
                let sums = Sums::new(ratios.iter().copied());
                let starts = (0..ratios.len() / BLOCK).map(|block| block * BLOCK);
                let starts = starts.filter(|start| is_told(&ratios[*start..*start + BLOCK]));
                self.0.extend(starts.map(|start| sums.hash(start, BLOCK)));
            }
        }
    }

    /// Number of a recording's rows in blocks of these shapes: the most that a direction, and a
    /// number of readings from one to the next, gives.
    pub fn matches(&self, rows: &[Row]) -> usize {
        let mut matches = [0; 2 * MAX_STRIDE];
        for run in runs(rows) {
            let backward: Vec<Row> = run.iter().rev().copied().collect();
            for (direction, run) in [run, &backward].into_iter().enumerate() {
                for (stride, offset) in strides() {
                    let found = self.found(&ratios(run.iter().skip(offset).step_by(stride)));
                    matches[direction * MAX_STRIDE + stride - 1] += found;
                }
            }
        }
        matches.into_iter().max().unwrap_or(0)
    }

    /// Ratios in blocks of these shapes.
    fn found(&self, ratios: &[u64]) -> usize {
        let sums = Sums::new(ratios.iter().copied());
        let (mut found, mut end) = (0, 0);
        for start in 0..(ratios.len() + 1).saturating_sub(BLOCK) {
            let is_new = start + BLOCK > end;
            if is_new && self.0.contains(&sums.hash(start, BLOCK)) {
                found += start + BLOCK - end.max(start);
                end = start + BLOCK;
            }
        }
        found
    }
}

/// Numbers of readings from one to the next, each with the first reading.
fn strides() -> impl Iterator<Item = (usize, usize)> {
    (1..=MAX_STRIDE).flat_map(|stride| (0..stride).map(move |offset| (stride, offset)))
}

/// The ratio of each reading to the one before, rounded, spread over 64 bits.
fn ratios<'a>(rows: impl Iterator<Item = &'a Row>) -> Vec<u64> {
    /// Dropped bits of an f32's mantissa. The others are exact to .1 %.
    const DROPPED: u32 = 14;
    let readings_w: Vec<f32> = rows.map(|row| row.target_w).collect();
    let ratio = |pair: &[f32]| {
        let ratio = pair[1] / pair[0];
        // After a reading of 0 W nothing is known.
        let bits = if ratio.is_finite() { ratio.to_bits() } else { 0 };
        mixed(u64::from(bits.wrapping_add(1 << (DROPPED - 1)) >> DROPPED))
    };
    readings_w.windows(2).map(ratio).collect()
}

fn is_told(ratios: &[u64]) -> bool {
    let changes = ratios.windows(2).filter(|pair| pair[0] != pair[1]);
    changes.count() >= FEWEST_CHANGES
}
