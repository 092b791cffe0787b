//! The batched kernel: one source, compiled for several instruction sets.
//!
//! A tile is a number of robots side by side; each value of a layer is a column with one lane per
//! robot. A lane never meets another lane, and each lane repeats the reference's operations in the
//! reference's order, so width and position can't change a bit.

use crate::gelu::gelu;
use crate::network::{canonical, inverse_std};
use crate::{FEATURES, FeatureSet, Features, HIDDEN, Parameters};

/// Outputs that are packed together, so that a step over one input reads consecutive weights.
const BLOCK: usize = 8;
const WIDEST: usize = HIDDEN[0];

/// Which build of the kernel runs; all give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Whatever the target's baseline offers. On x86-64 without FMA the fused multiply-adds are
    /// computed in software: exact and slow.
    Baseline,
    /// AVX2 and FMA.
    Avx2,
    /// AVX-512F.
    Avx512,
}

impl Kernel {
    /// All kernels, slowest first.
    pub const ALL: [Kernel; 3] = [Kernel::Baseline, Kernel::Avx2, Kernel::Avx512];

    /// Whether this CPU can run it.
    pub fn is_available(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        match self {
            Kernel::Baseline => true,
            Kernel::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            Kernel::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            self == Kernel::Baseline
        }
    }

    /// The fastest one that this CPU can run.
    pub fn best() -> Kernel {
        let available = Kernel::ALL
            .into_iter()
            .rev()
            .find(|kernel| kernel.is_available());
        available.unwrap_or(Kernel::Baseline)
    }

    /// Forecasts each row. Only `Network` calls this, with a kernel that `is_available`.
    pub(crate) fn run(self, packed: &Packed, inputs: &[Features], out_w: &mut [f32]) {
        match self {
            Kernel::Baseline => tiles::<16, 4>(packed, inputs, out_w),
            // SAFETY: `Network` holds this variant only after `is_available` detected its features.
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2 => unsafe { avx2(packed, inputs, out_w) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512 => unsafe { avx512(packed, inputs, out_w) },
            #[cfg(not(target_arch = "x86_64"))]
            Kernel::Avx2 | Kernel::Avx512 => tiles::<16, 4>(packed, inputs, out_w),
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2(packed: &Packed, inputs: &[Features], out_w: &mut [f32]) {
    tiles::<16, 4>(packed, inputs, out_w);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx2,fma")]
fn avx512(packed: &Packed, inputs: &[Features], out_w: &mut [f32]) {
    tiles::<32, 8>(packed, inputs, out_w);
}

/// The parameters in the order in which the kernel reads them.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    feature_set: FeatureSet,
    mean: Features,
    inverse_std: Features,
    hidden: [PackedLayer; 3],
    last_weights: [f32; HIDDEN[2]],
    last_bias: f32,
    power_mean_w: f32,
    power_std_w: f32,
}

#[derive(Clone, Debug)]
struct PackedLayer {
    /// Block by block, input by input: the weights of one input to the outputs of the block.
    weights: Box<[[f32; BLOCK]]>,
    bias: Box<[[f32; BLOCK]]>,
}

impl Packed {
    /// Parameters must have passed the network's checks.
    pub(crate) fn new(parameters: &Parameters) -> Packed {
        let [first, second, third, last] = &parameters.layers;
        let pack = |layer: &crate::Layer| {
            let inputs = layer.weights.len() / layer.bias.len();
            let (bias, _) = layer.bias.as_chunks::<BLOCK>();
            let weights = (0..bias.len()).flat_map(|block| {
                (0..inputs).map(move |input| {
                    std::array::from_fn(|j| layer.weights[(block * BLOCK + j) * inputs + input])
                })
            });
            PackedLayer {
                weights: weights.collect(),
                bias: bias.into(),
            }
        };
        Packed {
            feature_set: parameters.feature_set,
            mean: parameters.normalisation.feature_mean,
            inverse_std: parameters.normalisation.feature_std.map(inverse_std),
            hidden: [pack(first), pack(second), pack(third)],
            last_weights: std::array::from_fn(|i| last.weights[i]),
            last_bias: last.bias[0],
            power_mean_w: parameters.normalisation.power_mean_w,
            power_std_w: parameters.normalisation.power_std_w,
        }
    }
}

/// Whole tiles of `LANES` robots, then what is left in the narrowest tiles that hold it.
#[inline(always)]
fn tiles<const LANES: usize, const OUTPUTS: usize>(
    packed: &Packed,
    inputs: &[Features],
    out_w: &mut [f32],
) {
    let count = inputs.len().min(out_w.len());
    let whole = count - count % LANES;
    run_tiles::<LANES, OUTPUTS>(packed, &inputs[..whole], &mut out_w[..whole]);
    let (inputs, out_w) = (&inputs[whole..count], &mut out_w[whole..count]);
    if inputs.len() > 16 {
        run_tiles::<LANES, OUTPUTS>(packed, inputs, out_w);
    } else if inputs.len() > 8 {
        run_tiles::<16, 4>(packed, inputs, out_w);
    } else {
        run_tiles::<8, 8>(packed, inputs, out_w);
    }
}

#[inline(always)]
fn run_tiles<const LANES: usize, const OUTPUTS: usize>(
    packed: &Packed,
    inputs: &[Features],
    out_w: &mut [f32],
) {
    if inputs.is_empty() {
        return;
    }
    let mut rows = [Column([0.0; LANES]); FEATURES];
    let mut odd = [Column([0.0; LANES]); WIDEST];
    let mut even = [Column([0.0; LANES]); WIDEST];
    for (inputs, out_w) in inputs.chunks(LANES).zip(out_w.chunks_mut(LANES)) {
        let used = packed.feature_set.inputs();
        gather(packed, inputs, &mut rows[..used]);
        let [first, second, third] = &packed.hidden;
        hidden::<LANES, OUTPUTS>(first, &rows[..used], &mut odd);
        hidden::<LANES, OUTPUTS>(second, &odd, &mut even);
        hidden::<LANES, OUTPUTS>(third, &even, &mut odd);
        let mut sum = [packed.last_bias; LANES];
        for (weight, column) in packed.last_weights.iter().zip(&odd) {
            for (sum, x) in sum.iter_mut().zip(&column.0) {
                *sum = x.mul_add(*weight, *sum);
            }
        }
        for (out_w, sum) in out_w.iter_mut().zip(&sum) {
            *out_w = canonical(sum.mul_add(packed.power_std_w, packed.power_mean_w));
        }
    }
}

/// One value of every robot of a tile.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Column<const LANES: usize>([f32; LANES]);

/// Normalised features of up to `LANES` robots, as columns. Lanes without a robot keep what an
/// earlier tile left there; nobody reads their results.
#[inline(always)]
fn gather<const LANES: usize>(packed: &Packed, inputs: &[Features], columns: &mut [Column<LANES>]) {
    let first = packed.feature_set.first();
    for (lane, row) in inputs.iter().enumerate().take(LANES) {
        for (offset, column) in columns.iter_mut().enumerate() {
            let feature = first + offset;
            column.0[lane] = (row[feature] - packed.mean[feature]) * packed.inverse_std[feature];
        }
    }
}

/// A hidden layer: `OUTPUTS` sums of a block at a time stay in registers.
#[inline(always)]
fn hidden<const LANES: usize, const OUTPUTS: usize>(
    layer: &PackedLayer,
    input: &[Column<LANES>],
    output: &mut [Column<LANES>],
) {
    let blocks = layer.weights.chunks_exact(input.len()).zip(&layer.bias);
    for ((weights, bias), output) in blocks.zip(output.chunks_exact_mut(BLOCK)) {
        for part in 0..BLOCK / OUTPUTS {
            let start = part * OUTPUTS;
            let mut sums: [[f32; LANES]; OUTPUTS] =
                std::array::from_fn(|j| [bias[start + j]; LANES]);
            for (x, weights) in input.iter().zip(weights) {
                for (j, sum) in sums.iter_mut().enumerate() {
                    let weight = weights[start + j];
                    for (sum, x) in sum.iter_mut().zip(&x.0) {
                        *sum = x.mul_add(weight, *sum);
                    }
                }
            }
            for (column, sum) in output[start..].iter_mut().zip(&sums) {
                for (value, sum) in column.0.iter_mut().zip(sum) {
                    *value = gelu(*sum);
                }
            }
        }
    }
}
