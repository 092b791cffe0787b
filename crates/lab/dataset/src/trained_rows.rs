//! Recognises rows that a model was trained on.
//!
//! Rows are identified by their readings, in order, to 12 bits of their mantissa. A file's name,
//! format, units, times, velocities and robot do not count. The readings of each gapless run of
//! training rows are cut into blocks, and the model file has a hash of each block. A recording is
//! compared at every offset. It is therefore recognised renamed, copied, converted, played and
//! captured, imported, cut at its ends, or as part of a longer one. It is not recognised when it is
//! resampled, reversed or scaled, or its readings are changed by more than rounding. Of short pieces
//! and of those whose readings hardly change, [nothing is known](is_untold).

use std::collections::BTreeMap;

use joulebus_predictor::training::{TrainedBlocks, TrainedRows};
use joulebus_predictor::{FeatureSet, LAGS};

use crate::rows::{Dataset, Row};
use crate::split::PAUSE_ROWS;

/// Minimum and usual number of rows of a block.
const SHORTEST: usize = 16;
const USUAL: usize = 64;
/// Blocks up to which their usual length is kept. Above, it is doubled.
const MAX_BLOCKS: usize = 4_096;
/// Blocks above which a model states none: they are of many short runs, and the file would be too
/// large.
const MAX_SHORT: usize = 4 * MAX_BLOCKS;
/// Minimum number of changes of the reading in a recognised stretch, because resting robots repeat
/// short sequences of a coarse monitor's readings by chance.
const FEWEST_CHANGES: usize = 24;
/// The same for a whole gapless run of at least [`USUAL`] rows, all of which is recognised.
const FEWEST_CHANGES_OF_WHOLE: usize = 12;
/// Odd, so that every power of it has an inverse.
const BASE: u64 = 0x9e37_79b9_7f4a_7c15;

const NEWEST: usize = FeatureSet::PowerOnly.first();

/// Hashes of the rows for fitting and for early stopping. `None` if there are too many short runs
/// to state them.
pub fn trained_rows(dataset: &Dataset) -> Option<TrainedRows> {
    hashed([&dataset.training, &dataset.validation])
}

/// Hashes of the rows of some parts of a dataset, as [`trained_rows`].
pub fn hashed<const N: usize>(parts: [&[Row]; N]) -> Option<TrainedRows> {
    let mut stretches: Vec<Vec<u64>> = Vec::new();
    for part in parts {
        stretches.extend(self::stretches(part));
    }
    let count = |length: usize| -> usize {
        let blocks = stretches.iter().map(|stretch| starts(stretch.len(), length).count());
        blocks.sum()
    };
    let longest = stretches.iter().map(Vec::len).max().unwrap_or(0);
    let mut length = USUAL;
    while length < longest && count(length) > MAX_BLOCKS {
        length *= 2;
    }
    if count(length) > MAX_SHORT {
        return None;
    }
    let mut blocks = BTreeMap::<usize, Vec<u64>>::new();
    for stretch in &stretches {
        let sums = Sums::new(stretch.iter().copied());
        let rows = block_rows(stretch.len(), length);
        let hashes = starts(stretch.len(), length).map(|start| sums.hash(start, rows));
        blocks.entry(rows).or_default().extend(hashes);
    }
    let blocks = blocks.into_iter().map(|(rows, mut hashes)| {
        hashes.sort_unstable();
        hashes.dedup();
        let rows = u32::try_from(rows).unwrap_or(u32::MAX);
        TrainedBlocks { rows, hashes }
    });
    Some(TrainedRows {
        rows: parts.iter().map(|part| part.len() as u64).sum(),
        blocks: blocks.collect(),
    })
}

/// For each row of a recording, in order, whether it was trained on. Rows that share a reading's
/// window with one that was (within [`PAUSE_ROWS`]) count as such.
pub fn is_trained_on(rows: &[Row], trained: &TrainedRows) -> Vec<bool> {
    let sums = Sums::new(rows.iter().map(element));
    // +1 at the start of a recognised block, −1 after its end.
    let mut edges = vec![0_i64; rows.len() + 1];
    for group in &trained.blocks {
        let length = group.rows as usize;
        let Some(last) = rows.len().checked_sub(length) else {
            continue;
        };
        let is_known = |hash: u64| group.hashes.binary_search(&hash).is_ok();
        for start in (0..=last).filter(|start| is_known(sums.hash(*start, length))) {
            edges[start] += 1;
            edges[start + length] -= 1;
        }
    }
    let mut depth = 0;
    let inside = edges[..rows.len()].iter().map(|edge| {
        depth += edge;
        depth > 0
    });
    widened(&inside.collect::<Vec<bool>>(), rows)
}

/// For each row of a recording, in order, whether it is unknown if it was trained on: it is not
/// recognised ([`is_trained_on`]), and a copy of it might not be either. Its piece of a gapless
/// run, up to recognised rows, may contain no whole block of the longer run that it was cut from,
/// or changes too rarely.
pub fn is_untold(rows: &[Row], is_known: &[bool], trained: &TrainedRows) -> Vec<bool> {
    let block = trained.blocks.iter().map(|group| group.rows as usize).max().unwrap_or(0);
    let mut untold = Vec::with_capacity(rows.len());
    for run in runs(rows) {
        let of_run = &is_known[untold.len()..][..run.len()];
        let mut end = 0;
        for piece in of_run.chunk_by(|a, b| a == b) {
            let start = end;
            end += piece.len();
            let is_untold = !piece[0] && !is_told(&run[start..end], block);
            untold.extend(std::iter::repeat_n(is_untold, piece.len()));
        }
    }
    untold
}

/// Whether this piece would be recognised if it was cut from a longer run that was trained on,
/// wherever the blocks of that run begin.
fn is_told(piece: &[Row], block: usize) -> bool {
    // Element n counts the changes up to row n.
    let mut changed = 0;
    let pairs = piece.windows(2);
    let counts = pairs.map(|pair| {
        changed += usize::from(is_change(&pair[0], &pair[1]));
        changed
    });
    let counts: Vec<usize> = std::iter::once(0).chain(counts).collect();
    let is_recognised = |start: usize| {
        let blocks = (piece.len() - start) / block;
        blocks > 0 && counts[start + blocks * block - 1] - counts[start] + 1 >= FEWEST_CHANGES
    };
    (1..=piece.len()).contains(&block) && (0..block).all(is_recognised)
}

/// The gapless runs of some rows, in order.
pub fn runs(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(follows)
}

/// Changes needed to recognise a whole gapless run.
const fn fewest_changes(run: usize) -> usize {
    if run < USUAL { FEWEST_CHANGES } else { FEWEST_CHANGES_OF_WHOLE }
}

/// Number of different readings in a row.
fn changes(rows: &[Row]) -> usize {
    let pairs = rows.windows(2);
    pairs.filter(|pair| is_change(&pair[0], &pair[1])).count() + usize::from(!rows.is_empty())
}

fn is_change(before: &Row, after: &Row) -> bool {
    before.target_w.to_bits() != after.target_w.to_bits()
}

/// Without stretches of too few changes, and with the rows beside the others.
fn widened(found: &[bool], rows: &[Row]) -> Vec<bool> {
    let mut trained = vec![false; rows.len()];
    let is_end = |at: usize| at == 0 || at == rows.len() || !follows(&rows[at - 1], &rows[at]);
    let mut end = 0;
    for stretch in found.chunk_by(|a, b| a == b) {
        let start = end;
        end += stretch.len();
        let fewest = match is_end(start) && is_end(end) {
            true => fewest_changes(end - start),
            false => FEWEST_CHANGES,
        };
        if stretch[0] && changes(&rows[start..end]) >= fewest {
            let beside = start.saturating_sub(PAUSE_ROWS)..(end + PAUSE_ROWS).min(rows.len());
            trained[beside].fill(true);
        }
    }
    trained
}

/// The readings of each gapless run. Runs shorter than a block are joined while they follow each
/// other.
fn stretches(rows: &[Row]) -> Vec<Vec<u64>> {
    let mut stretches: Vec<Vec<u64>> = Vec::new();
    let mut joined: Vec<u64> = Vec::new();
    for run in runs(rows) {
        let elements = run.iter().map(element);
        if run.len() >= SHORTEST {
            joined.clear();
            stretches.push(elements.collect());
            continue;
        }
        joined.extend(elements);
        if joined.len() >= SHORTEST {
            stretches.push(std::mem::take(&mut joined));
        }
    }
    stretches
}

/// True if one row's window is the previous row's window and reading.
fn follows(before: &Row, after: &Row) -> bool {
    let lags = |row: &Row| -> [u32; LAGS] {
        std::array::from_fn(|lag| row.features[NEWEST + lag].to_bits())
    };
    let (before_lags, after_lags) = (lags(before), lags(after));
    after_lags[0] == before.target_w.to_bits() && after_lags[1..] == before_lags[..LAGS - 1]
}

/// Rows of a block of a run, of at least [`SHORTEST`] rows: `length`, a power of two, or the
/// largest that fits.
fn block_rows(run: usize, length: usize) -> usize {
    length.min(1 << run.ilog2())
}

/// The first rows of the blocks of a run: the last block ends with the run.
fn starts(run: usize, length: usize) -> impl Iterator<Item = usize> {
    let rows = block_rows(run, length);
    let last = run - rows;
    (0..last).step_by(rows).chain([last])
}

/// A row's reading, rounded, spread over 64 bits.
fn element(row: &Row) -> u64 {
    /// Dropped bits of an f32's mantissa. The others are exact to 1.2e-4.
    const DROPPED: u32 = 11;
    // −0 is 0.
    let bits = (row.target_w + 0.0).to_bits();
    let rounded = bits.wrapping_add(1 << (DROPPED - 1)) >> DROPPED;
    mixed(u64::from(rounded).wrapping_add(BASE))
}

/// Every bit depends on every bit (SplitMix64's finaliser).
fn mixed(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Hashes of any part of a sequence: polynomials in [`BASE`], from sums over its beginnings.
struct Sums {
    /// The sum of the first n elements, at index n.
    sums: Vec<u64>,
    /// Powers of the base.
    powers: Vec<u64>,
}

impl Sums {
    pub(crate) fn new(elements: impl Iterator<Item = u64>) -> Self {
        let (mut sums, mut powers) = (vec![0_u64], vec![1_u64]);
        for (at, element) in elements.enumerate() {
            sums.push(sums[at].wrapping_mul(BASE).wrapping_add(element));
            powers.push(powers[at].wrapping_mul(BASE));
        }
        Self { sums, powers }
    }

    pub(crate) fn hash(&self, start: usize, length: usize) -> u64 {
        let before = self.sums[start].wrapping_mul(self.powers[length]);
        mixed(self.sums[start + length].wrapping_sub(before))
    }
}
