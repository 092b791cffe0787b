//! Tiling of a batch: batch-major for whole vectors of robots, output-major for the remainder.

#![allow(
    clippy::needless_range_loop,
    reason = "indices of tiles are plainer than iterators, and every loop has to unroll"
)]

use super::forward::{BatchMajor, OutputMajor};
use super::lanes::{Job, Lanes};
use super::packed::{Packed, Read};
use crate::features::{Features, INPUTS};

/// Tiling of a batch. It does not change the bits.
///
/// ```
/// # use joulebus_predictor::{Features, Network, Tiling};
/// # fn example(network: Network, rows: &[Features]) {
/// let (mut usual_w, mut other_w) = (vec![0.0; rows.len()], vec![0.0; rows.len()]);
/// network.predict(rows, &mut usual_w);
/// network.with_tiling(Tiling::BatchMajor).predict(rows, &mut other_w);
/// assert_eq!(usual_w, other_w);
/// # }
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Tiling {
    /// Output-major for rows. Batch-major for columns, and with AVX-512 for rows, with an
    /// output-major remainder. This is the fastest for every batch, and the default.
    ByInput,
    /// Batch-major for whole vectors of robots: a vector holds one value of several robots.
    BatchMajor,
    /// Output-major: a vector holds neighbouring outputs of one robot.
    OutputMajor,
}

pub(crate) trait BatchInput: Copy {
    /// True if batch-major loads are faster than output-major ones.
    const IS_COLUMNS: bool;

    /// `N` rows from `start`, assembled in `space` if necessary. Features that are not read are
    /// unspecified.
    fn rows<'b, const N: usize>(
        &'b self,
        start: usize,
        read: Read,
        space: &'b mut [Features; N],
    ) -> &'b [Features; N];

    /// `R` vectors of rows from `start`, as columns. Columns that are not read are left unchanged.
    fn columns<L: Lanes, const R: usize>(
        self,
        lanes: L,
        start: usize,
        read: Read,
        columns: &mut [[L::Vector; R]; INPUTS],
    );
}

/// Input in rows.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a>(pub(crate) &'a [Features]);

impl BatchInput for Rows<'_> {
    const IS_COLUMNS: bool = false;

    #[inline(always)]
    fn rows<'b, const N: usize>(
        &'b self,
        start: usize,
        _: Read,
        space: &'b mut [Features; N],
    ) -> &'b [Features; N] {
        self.0[start..].first_chunk().unwrap_or(space)
    }

    #[inline(always)]
    fn columns<L: Lanes, const R: usize>(
        self,
        lanes: L,
        start: usize,
        read: Read,
        columns: &mut [[L::Vector; R]; INPUTS],
    ) {
        for r in 0..R {
            let rows = &self.0[start + r * L::WIDTH..][..L::WIDTH];
            let mut transposed = [[0.0; 16]; INPUTS];
            for (lane, row) in rows.iter().enumerate() {
                for feature in 0..INPUTS {
                    transposed[feature][lane] = row[feature];
                }
            }
            for feature in read.first..read.end {
                columns[feature][r] = lanes.load(&transposed[feature]);
            }
        }
    }
}

/// Input in columns of equal length. Those that the model does not read may be empty.
#[derive(Clone, Copy)]
pub(crate) struct Columns<'a>(pub(crate) &'a [&'a [f32]; INPUTS]);

impl BatchInput for Columns<'_> {
    const IS_COLUMNS: bool = true;

    #[inline(always)]
    fn rows<'b, const N: usize>(
        &'b self,
        start: usize,
        read: Read,
        space: &'b mut [Features; N],
    ) -> &'b [Features; N] {
        for feature in read.first..read.end {
            let values = &self.0[feature][start..start + N];
            for n in 0..N {
                space[n][feature] = values[n];
            }
        }
        space
    }

    #[inline(always)]
    fn columns<L: Lanes, const R: usize>(
        self,
        lanes: L,
        start: usize,
        read: Read,
        columns: &mut [[L::Vector; R]; INPUTS],
    ) {
        for feature in read.first..read.end {
            for r in 0..R {
                let place = start + r * L::WIDTH;
                columns[feature][r] = lanes.load(&self.0[feature][place..]);
            }
        }
    }
}

/// A batch. `R`, `C` and `N` are the CPU's tile sizes of [`BatchMajor`] and [`OutputMajor`].
pub(crate) struct Batch<'a, S: BatchInput, const R: usize, const C: usize, const N: usize> {
    pub(crate) packed: &'a Packed,
    pub(crate) tiling: Tiling,
    /// Source of as many rows as `out_w` has elements.
    pub(crate) source: S,
    pub(crate) out_w: &'a mut [f32],
}

impl<L: Lanes, S: BatchInput, const R: usize, const C: usize, const N: usize> Job<L>
    for Batch<'_, S, R, C, N>
{
    #[inline(always)]
    fn run(self, lanes: L) {
        let (packed, source) = (self.packed, self.source);
        let mut rest = self.out_w;
        let mut done = 0;
        let by_input = S::IS_COLUMNS || L::GELU_OVERLAPS;
        if self.tiling == Tiling::ByInput && by_input || self.tiling == Tiling::BatchMajor {
            let (wide, after) = rest.split_at_mut(whole(rest.len(), R * L::WIDTH));
            batch_major::<L, S, R, C>(lanes, packed, source, done, wide);
            done += wide.len();
            let (narrow, after) = after.split_at_mut(whole(after.len(), L::WIDTH));
            if R > 1 {
                batch_major::<L, S, 1, 8>(lanes, packed, source, done, narrow);
            }
            done += narrow.len();
            rest = after;
        }
        let (tiles, rest) = rest.as_chunks_mut::<N>();
        for tile in tiles {
            output_major(lanes, packed, source, done, tile);
            done += N;
        }
        match rest.len() {
            1 => few::<L, S, 1>(lanes, packed, source, done, rest),
            2 => few::<L, S, 2>(lanes, packed, source, done, rest),
            3 if N > 3 => few::<L, S, 3>(lanes, packed, source, done, rest),
            _ => {}
        }
    }
}

/// The largest multiple of `tile` up to `count`.
#[inline(always)]
pub(crate) const fn whole(count: usize, tile: usize) -> usize {
    count - count % tile
}

/// Full tiles of `R` vectors of robots.
#[inline(always)]
fn batch_major<L: Lanes, S: BatchInput, const R: usize, const C: usize>(
    lanes: L,
    packed: &Packed,
    source: S,
    start: usize,
    out_w: &mut [f32],
) {
    if out_w.is_empty() {
        return;
    }
    let mut inputs = [[lanes.splat(0.0); R]; INPUTS];
    for (tile, out_w) in out_w.chunks_exact_mut(R * L::WIDTH).enumerate() {
        let start = start + tile * R * L::WIDTH;
        source.columns(lanes, start, packed.read, &mut inputs);
        lanes.run(BatchMajor::<L, R, C> { packed, inputs: &inputs, out_w });
    }
}

#[inline(always)]
fn few<L: Lanes, S: BatchInput, const N: usize>(
    lanes: L,
    packed: &Packed,
    source: S,
    start: usize,
    out_w: &mut [f32],
) {
    let (tiles, _) = out_w.as_chunks_mut::<N>();
    for tile in tiles {
        output_major(lanes, packed, source, start, tile);
    }
}

#[inline(always)]
fn output_major<L: Lanes, S: BatchInput, const N: usize>(
    lanes: L,
    packed: &Packed,
    source: S,
    start: usize,
    out_w: &mut [f32; N],
) {
    lanes.run(OutputMajor {
        packed,
        rows: source.rows(start, packed.read, &mut [[0.0; INPUTS]; N]),
        out_w,
    });
}
