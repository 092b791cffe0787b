//! Arithmetic of training: matrix products and GELU, sixteen numbers at a time.
//!
//! Every number is computed by the same operations in the same order at every vector width, on
//! every machine: fused multiply-adds along one index, in ascending order.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, u32x16};

/// Vector width. The widths of all layers except the last are multiples of it.
pub(super) const LANES: usize = 16;

/// The left factor of a product: element (row, inner) is at `row * row_step + inner * inner_step`.
#[derive(Clone, Copy)]
pub(super) struct Left<'a> {
    pub values: &'a [f32],
    pub row_step: usize,
    pub inner_step: usize,
}

/// `out += left · right`, with `out` of `rows` rows and `right` of `inner` rows, both `columns`
/// (a multiple of [`LANES`]) wide.
#[inline(always)]
pub(super) fn add_product<S: Simd>(
    simd: S,
    left: Left<'_>,
    right: &[f32],
    columns: usize,
    out: &mut [f32],
) {
    let wide = S::f32s::LEN == LANES;
    let inner = right.len() / columns;
    let rows = out.len() / columns;
    let mut row = 0;
    while row < rows {
        let left_rows = rows - row;
        let mut column = 0;
        let step = if wide && left_rows >= 4 {
            4
        } else if left_rows >= 2 {
            2
        } else {
            1
        };
        while column < columns {
            let vectors = (columns - column) / LANES;
            let at = TilePosition { row, column, columns, inner };
            column += LANES
                * match (step, vectors) {
                    (4, 4..) => tile::<S, 4, 4>(simd, left, right, out, at),
                    (4, 2..) => tile::<S, 4, 2>(simd, left, right, out, at),
                    (4, _) => tile::<S, 4, 1>(simd, left, right, out, at),
                    (2, 2..) => tile::<S, 2, 2>(simd, left, right, out, at),
                    (2, _) => tile::<S, 2, 1>(simd, left, right, out, at),
                    (_, _) => tile::<S, 1, 1>(simd, left, right, out, at),
                };
        }
        row += step;
    }
}

#[derive(Clone, Copy)]
struct TilePosition {
    row: usize,
    column: usize,
    columns: usize,
    inner: usize,
}

#[inline(always)]
fn tile<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    left: Left<'_>,
    right: &[f32],
    out: &mut [f32],
    at: TilePosition,
) -> usize {
    let TilePosition { row, column, columns, inner } = at;
    let mut sums = [[f32x16::splat(simd, 0.0); VECTORS]; ROWS];
    for (r, sums) in sums.iter_mut().enumerate() {
        let start = (row + r) * columns + column;
        for (v, sum) in sums.iter_mut().enumerate() {
            *sum = f32x16::from_slice(simd, &out[start + v * LANES..][..LANES]);
        }
    }
    for k in 0..inner {
        let start = k * columns + column;
        let mut line = [f32x16::splat(simd, 0.0); VECTORS];
        for (v, line) in line.iter_mut().enumerate() {
            *line = f32x16::from_slice(simd, &right[start + v * LANES..][..LANES]);
        }
        for (r, sums) in sums.iter_mut().enumerate() {
            let factor =
                f32x16::splat(simd, left.values[(row + r) * left.row_step + k * left.inner_step]);
            for (sum, line) in sums.iter_mut().zip(line) {
                *sum = factor.mul_add_precise(line, *sum);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        let start = (row + r) * columns + column;
        for (v, sum) in sums.iter().enumerate() {
            sum.store_slice(&mut out[start + v * LANES..][..LANES]);
        }
    }
    VECTORS
}

/// Value and slope of the GELU. Normal distribution by formula 26.2.17 of Abramowitz and Stegun,
/// Handbook of Mathematical Functions: error at most 7.5e-8.
#[inline(always)]
pub(super) fn gelu_and_slope<S: Simd>(simd: S, x: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    const P: f32 = 0.231_641_9;
    const B: [f32; 5] = [0.319_381_54, -0.356_563_78, 1.781_477_9, -1.821_255_9, 1.330_274_4];
    const DENSITY: f32 = 0.398_942_3;
    let one = f32x16::splat(simd, 1.0);
    let size = x.abs();
    let density = exp_of_minus(simd, (size * size) * 0.5) * DENSITY;
    let t = one / size.mul_add_precise(f32x16::splat(simd, P), one);
    let tail = density * (series(simd, t, B) * t);
    let below = x.simd_ge(f32x16::splat(simd, 0.0)).select(one - tail, tail);
    (x * below, x.mul_add_precise(density, below))
}

/// exp(−`x`) for `x` ≥ 0. It is 0 beyond 87.
#[inline(always)]
fn exp_of_minus<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    const ROUND: f32 = 12_582_912.0;
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    const SERIES: [f32; 7] =
        [1.0, 1.0, 0.5, 0.166_666_67, 0.041_666_67, 0.008_333_334, 0.001_388_889];
    let most = f32x16::splat(simd, 87.0);
    let zero = f32x16::splat(simd, 0.0);
    let y = zero - x.min(most);
    let round = f32x16::splat(simd, ROUND);
    let shifted = y.mul_add_precise(f32x16::splat(simd, std::f32::consts::LOG2_E), round);
    let whole = shifted - round;
    let rest = whole.mul_add_precise(f32x16::splat(simd, -LN_2_HIGH), y);
    let rest = whole.mul_add_precise(f32x16::splat(simd, -LN_2_LOW), rest);
    let bits: u32x16<S> = shifted.to_bits();
    let power = f32x16::from_bits((bits << 23) + u32x16::splat(simd, 127 << 23));
    x.simd_gt(most).select(zero, series(simd, rest, SERIES) * power)
}

/// A polynomial by Horner's rule, constant first. A loop instead of an iterator, because closures
/// that are not inlined lose the vector instructions.
#[inline(always)]
fn series<S: Simd, const N: usize>(simd: S, x: f32x16<S>, factors: [f32; N]) -> f32x16<S> {
    let mut sum = f32x16::splat(simd, factors[N - 1]);
    let mut term = N - 1;
    while term > 0 {
        term -= 1;
        sum = sum.mul_add_precise(x, f32x16::splat(simd, factors[term]));
    }
    sum
}
