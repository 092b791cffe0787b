//! Forward pass for a tile of robots, in two tilings.
//!
//! - [`BatchMajor`]: a vector holds one value of several robots. Every value of a layer is a
//!   column, and weights are broadcast. It is the fastest in bulk.
//! - [`OutputMajor`]: a vector holds neighbouring outputs of one robot. Weights are loaded, the
//!   inputs of up to four robots broadcast. It is the fastest for a few robots.
//!
//! Both perform the operations of [`Network::predict_reference_f32`](crate::Network) in its order,
//! for each robot separately.

#![allow(
    clippy::needless_range_loop,
    reason = "indices of tiles are plainer than iterators, and every loop has to unroll"
)]

use super::lanes::{Job, Lanes};
use super::packed::{Dense, LINE, Packed, Read};
use super::scalar::Scalar;
use crate::features::{Features, INPUTS};
use crate::gelu::{LIMIT, MAGIC};
use crate::nan::canonical;
use crate::parameters::HIDDEN;
use std::mem::MaybeUninit;

const WIDE: usize = HIDDEN[0];
const NARROW: usize = HIDDEN[2];
/// Inputs by which GELU runs ahead of the multiply-adds that need it: more than its latency.
const AHEAD: usize = 4;

/// GELU with its table in registers.
struct Gelu<L: Lanes> {
    table: [L::Table; 6],
    limit: L::Vector,
    magic: L::Vector,
}

impl<L: Lanes> Gelu<L> {
    #[inline(always)]
    fn new(lanes: L, coefficients: &[[f32; 8]; 6]) -> Gelu<L> {
        let mut table = [lanes.table(&coefficients[0]); 6];
        for power in 1..6 {
            table[power] = lanes.table(&coefficients[power]);
        }
        Gelu { table, limit: lanes.splat(LIMIT), magic: lanes.splat(MAGIC) }
    }

    /// [`Activation::scaled_value`] of every lane.
    #[inline(always)]
    fn apply(&self, lanes: L, y: L::Vector) -> L::Vector {
        let magnitude = lanes.abs(y);
        let clamped = lanes.at_most(magnitude, self.limit);
        let segment = lanes.add(clamped, self.magic);
        let mut tail = lanes.lookup(self.table[5], segment);
        for power in [4, 3, 2, 1, 0] {
            let coefficient = lanes.lookup(self.table[power], segment);
            tail = lanes.mul_add(tail, clamped, coefficient);
        }
        lanes.add(lanes.add(y, magnitude), tail)
    }

    #[inline(always)]
    fn apply_all<const R: usize>(&self, lanes: L, values: &mut [L::Vector; R]) {
        for value in values {
            *value = self.apply(lanes, *value);
        }
    }
}

/// Uninitialised memory for the values of a layer. Aligned to cache lines: a load across two costs
/// twice.
#[repr(C, align(64))]
struct Scratch<T, const O: usize>([MaybeUninit<T>; O]);

impl<T, const O: usize> Scratch<T, O> {
    const NEW: Scratch<T, O> = Scratch([const { MaybeUninit::uninit() }; O]);
}

/// # Safety
/// Every value must have been written.
#[inline(always)]
unsafe fn written<T, const O: usize>(scratch: &mut Scratch<T, O>) -> &mut [T; O] {
    // SAFETY: `MaybeUninit<T>` has the layout of `T`, and the caller wrote every value.
    unsafe { &mut *std::ptr::from_mut(&mut scratch.0).cast() }
}

/// `R` vectors of robots. `C` outputs of them at a time are held in registers.
pub(crate) struct BatchMajor<'a, L: Lanes, const R: usize, const C: usize> {
    pub(crate) packed: &'a Packed,
    /// Features in their units, as columns. Those that are not read are unspecified.
    pub(crate) inputs: &'a [[L::Vector; R]; INPUTS],
    /// Forecasts of `R * WIDTH` robots, W.
    pub(crate) out_w: &'a mut [f32],
}

impl<L: Lanes, const R: usize, const C: usize> Job<L> for BatchMajor<'_, L, R, C> {
    #[inline(always)]
    fn run(self, lanes: L) {
        let Packed {
            read,
            ref gelu,
            ref first,
            ref second,
            ref third,
            ref last_weights,
            last_bias,
        } = *self.packed;
        let gelu = &Gelu::new(lanes, gelu);
        // Two buffers for three layers: the one just read is written next, and stays in cache.
        let mut odd = Scratch::<[L::Vector; R], WIDE>::NEW;
        let mut even = Scratch::<[L::Vector; R], WIDE>::NEW;
        let mut narrow = Scratch::<[L::Vector; R], NARROW>::NEW;
        let mut inputs = *self.inputs;
        let all = Read::all(WIDE);
        // Who computes GELU of the first two layers: they, or the layer that reads them.
        let (own, next) = (!L::GELU_OVERLAPS, L::GELU_OVERLAPS);
        let values = columns::<L, R, C, _, _, _>(
            lanes,
            gelu,
            Activated { input: false, output: own },
            (first, read),
            &mut inputs,
            &mut odd,
        );
        let values = columns::<L, R, C, _, _, _>(
            lanes,
            gelu,
            Activated { input: next, output: own },
            (second, all),
            values,
            &mut even,
        );
        let values = columns::<L, R, C, _, _, _>(
            lanes,
            gelu,
            Activated { input: next, output: true },
            (third, all),
            values,
            &mut narrow,
        );
        for r in 0..R {
            let sum = last_of_columns(lanes, values, r, last_weights);
            let watt = lanes.add(sum, lanes.splat(last_bias));
            lanes.store(watt, &mut self.out_w[r * L::WIDTH..]);
        }
        for watt in &mut self.out_w[..R * L::WIDTH] {
            *watt = canonical(*watt);
        }
    }
}

/// How GELU of a hidden layer by columns is divided between it and the next.
#[derive(Clone, Copy)]
struct Activated {
    /// The input lacks GELU: it is computed while the first outputs are summed, where it overlaps
    /// with their multiply-adds.
    input: bool,
    /// Outputs get GELU as soon as they are summed.
    output: bool,
}

/// A hidden layer by columns: `C` outputs of `R` vectors of robots at a time.
#[inline(always)]
fn columns<
    'a,
    L: Lanes,
    const R: usize,
    const C: usize,
    const I: usize,
    const N: usize,
    const O: usize,
>(
    lanes: L,
    gelu: &Gelu<L>,
    activated: Activated,
    (layer, read): (&Dense<I, N>, Read),
    input: &mut [[L::Vector; R]; I],
    output: &'a mut Scratch<[L::Vector; R], O>,
) -> &'a mut [[L::Vector; R]; O] {
    const { assert!(O == N * LINE && LINE.is_multiple_of(C) && LINE.is_multiple_of(L::WIDTH)) };
    for line in 0..N {
        let (weights, bias) = (&layer.weights[line], &layer.bias[line].0);
        for part in 0..LINE / C {
            let start = part * C;
            let mut sums = [[lanes.splat(0.0); R]; C];
            for c in 0..C {
                sums[c] = [lanes.splat(bias[start + c]); R];
            }
            if activated.input && line == 0 && part == 0 {
                for k in 0..AHEAD.min(I) {
                    gelu.apply_all(lanes, &mut input[k]);
                }
                for k in 0..I {
                    if k + AHEAD < I {
                        gelu.apply_all(lanes, &mut input[k + AHEAD]);
                    }
                    multiply_add(lanes, &input[k], &weights[k].0[start..], &mut sums);
                }
            } else {
                let read = read.first..read.end;
                for (x, weights) in input[read.clone()].iter().zip(&weights[read]) {
                    multiply_add(lanes, x, &weights.0[start..], &mut sums);
                }
            }
            for c in 0..C {
                if activated.output {
                    gelu.apply_all(lanes, &mut sums[c]);
                }
                output.0[line * LINE + start + c].write(sums[c]);
            }
        }
    }
    // SAFETY: `N` lines of `LINE / C` parts of `C` outputs are all `O`, and each was written.
    unsafe { written(output) }
}

/// Adds one input to the sums of `C` outputs.
#[inline(always)]
fn multiply_add<L: Lanes, const R: usize, const C: usize>(
    lanes: L,
    x: &[L::Vector; R],
    weights: &[f32],
    sums: &mut [[L::Vector; R]; C],
) {
    let weights = &weights[..C];
    for c in 0..C {
        let weight = lanes.splat(weights[c]);
        for r in 0..R {
            sums[c][r] = lanes.mul_add(x[r], weight, sums[c][r]);
        }
    }
}

/// The weighted sum of the last hidden layer, in the order of [`last_of_row`].
#[inline(always)]
fn last_of_columns<L: Lanes, const R: usize>(
    lanes: L,
    values: &[[L::Vector; R]; NARROW],
    r: usize,
    weights: &[f32; NARROW],
) -> L::Vector {
    let mut sums = [lanes.splat(0.0); LINE];
    for i in 0..LINE {
        let low = lanes.mul(values[i][r], lanes.splat(weights[i]));
        let weight = lanes.splat(weights[LINE + i]);
        sums[i] = lanes.mul_add(values[LINE + i][r], weight, low);
    }
    tree(lanes, sums)
}

/// `N` robots, contiguous in memory.
pub(crate) struct OutputMajor<'a, const N: usize> {
    pub(crate) packed: &'a Packed,
    /// Features in their units. Those that are not read are unspecified.
    pub(crate) rows: &'a [Features; N],
    /// Forecasts, W.
    pub(crate) out_w: &'a mut [f32; N],
}

impl<L: Lanes, const N: usize> Job<L> for OutputMajor<'_, N> {
    #[inline(always)]
    fn run(self, lanes: L) {
        let packed = self.packed;
        let gelu = &Gelu::new(lanes, &packed.gelu);
        let mut odd = [const { Scratch::<f32, WIDE>::NEW }; N];
        let mut even = [const { Scratch::<f32, WIDE>::NEW }; N];
        let mut narrow = [const { Scratch::<f32, NARROW>::NEW }; N];
        let rows = self.rows.each_ref();
        let all = Read::all(WIDE);
        let values = rows_of_layer(lanes, gelu, &packed.first, packed.read, rows, &mut odd);
        let values = rows_of_layer(lanes, gelu, &packed.second, all, values, &mut even);
        let values = rows_of_layer(lanes, gelu, &packed.third, all, values, &mut narrow);
        for n in 0..N {
            let sum = last_of_row(lanes, values[n], &packed.last_weights);
            self.out_w[n] = canonical(sum + packed.last_bias);
        }
    }
}

/// A hidden layer of `N` robots, in groups of outputs whose sums fit into registers.
#[inline(always)]
fn rows_of_layer<'a, L: Lanes, const N: usize, const I: usize, const M: usize, const O: usize>(
    lanes: L,
    gelu: &Gelu<L>,
    layer: &Dense<I, M>,
    read: Read,
    input: [&[f32; I]; N],
    output: &'a mut [Scratch<f32, O>; N],
) -> [&'a [f32; O]; N] {
    const {
        assert!(O == M * LINE && L::SUMS >= 8 && N <= 4);
        // Groups of 8, 4 or 2 vectors of `WIDTH` are all `O` outputs.
        assert!(LINE.is_multiple_of(L::WIDTH) && (O / L::WIDTH).is_multiple_of(2));
    };
    // A constant: all branches except one are removed at compile time.
    match (O / L::WIDTH).min(L::SUMS / N) {
        8.. => grouped::<L, N, 8, I, M, O>(lanes, gelu, layer, read, input, output),
        4.. => grouped::<L, N, 4, I, M, O>(lanes, gelu, layer, read, input, output),
        _ => grouped::<L, N, 2, I, M, O>(lanes, gelu, layer, read, input, output),
    }
    // SAFETY: each of the calls above wrote every output of every robot.
    output.each_mut().map(|row| unsafe { &*written(row) })
}

#[inline(always)]
fn grouped<
    L: Lanes,
    const N: usize,
    const V: usize,
    const I: usize,
    const M: usize,
    const O: usize,
>(
    lanes: L,
    gelu: &Gelu<L>,
    layer: &Dense<I, M>,
    read: Read,
    input: [&[f32; I]; N],
    output: &mut [Scratch<f32, O>; N],
) {
    let per_line = LINE / L::WIDTH;
    for group in 0..O / L::WIDTH / V {
        let mut sums = [[lanes.splat(0.0); V]; N];
        for v in 0..V {
            let (line, place) = ((group * V + v) / per_line, (group * V + v) % per_line);
            let bias = lanes.load(&layer.bias[line].0[place * L::WIDTH..]);
            for n in 0..N {
                sums[n][v] = bias;
            }
        }
        // Bounded by `I`, so that indexing needs no bounds check.
        for k in read.first..read.end.min(I) {
            for v in 0..V {
                let (line, place) = ((group * V + v) / per_line, (group * V + v) % per_line);
                let weight = lanes.load(&layer.weights[line][k].0[place * L::WIDTH..]);
                for n in 0..N {
                    sums[n][v] = lanes.mul_add(lanes.splat(input[n][k]), weight, sums[n][v]);
                }
            }
        }
        for n in 0..N {
            for v in 0..V {
                let value = gelu.apply(lanes, sums[n][v]);
                lanes.store_new(value, &mut output[n].0[(group * V + v) * L::WIDTH..]);
            }
        }
    }
}

/// The weighted sum of the last hidden layer: sixteen products, to each of which the one sixteen
/// further on is added, then added pairwise. A sequential sum would make a single robot wait for 32
/// dependent multiply-adds.
#[inline(always)]
fn last_of_row<L: Lanes>(lanes: L, values: &[f32; NARROW], weights: &[f32; NARROW]) -> f32 {
    let mut sums = [0.0; LINE];
    for start in (0..LINE).step_by(L::WIDTH) {
        let low = lanes.mul(lanes.load(&values[start..]), lanes.load(&weights[start..]));
        let high = lanes.load(&values[LINE + start..]);
        let weight = lanes.load(&weights[LINE + start..]);
        lanes.store(lanes.mul_add(high, weight, low), &mut sums[start..]);
    }
    pairwise(sums)
}

/// Adds the second half to the first until one value remains.
#[inline(always)]
pub(crate) fn pairwise(sums: [f32; LINE]) -> f32 {
    tree(Scalar, sums)
}

/// Same as [`pairwise`], for every lane. Unrolled by hand, because the compiler does not unroll the
/// loop over the halves.
#[inline(always)]
fn tree<L: Lanes>(lanes: L, mut sums: [L::Vector; LINE]) -> L::Vector {
    for i in 0..8 {
        sums[i] = lanes.add(sums[i], sums[8 + i]);
    }
    for i in 0..4 {
        sums[i] = lanes.add(sums[i], sums[4 + i]);
    }
    let (even, odd) = (lanes.add(sums[0], sums[2]), lanes.add(sums[1], sums[3]));
    lanes.add(even, odd)
}
