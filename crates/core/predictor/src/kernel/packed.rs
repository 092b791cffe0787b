//! The parameters in the kernels' memory order.

use crate::features::{FEATURES, INPUTS};
use crate::gelu::SCALE;
use crate::parameters::{HIDDEN, Layer, Parameters};
use std::ops::Range;

/// Outputs that are packed together: a cache line, and the widest vector of any CPU.
pub(crate) const LINE: usize = 16;

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Line(pub(crate) [f32; LINE]);

/// A hidden layer with `I` inputs and `L` lines of outputs.
#[derive(Clone, Debug)]
pub(crate) struct Dense<const I: usize, const L: usize> {
    /// For each line and input, the weights of the input for the outputs of the line. One layout
    /// serves both tilings: output-major loads a line, batch-major broadcasts one weight of it.
    pub(crate) weights: [[Line; I]; L],
    pub(crate) bias: [Line; L],
}

impl<const I: usize, const L: usize> Dense<I, L> {
    /// `layer` has `L * LINE` outputs and the inputs `read` of `I`. The weights of the others are
    /// 0.
    fn new(layer: &Layer, read: Range<usize>) -> Dense<I, L> {
        let inputs = read.len();
        let weight = |output: usize, input: usize| match read.contains(&input) {
            true => layer.weights[output * inputs + input - read.start],
            false => 0.0,
        };
        Dense {
            weights: std::array::from_fn(|line| {
                std::array::from_fn(|input| {
                    Line(std::array::from_fn(|j| weight(line * LINE + j, input)))
                })
            }),
            bias: std::array::from_fn(|line| {
                Line(std::array::from_fn(|j| layer.bias[line * LINE + j]))
            }),
        }
    }
}

/// Inputs `first..end` of a layer: a range that is `Copy`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Read {
    pub(crate) first: usize,
    pub(crate) end: usize,
}

impl Read {
    /// The first `inputs`.
    pub(crate) const fn all(inputs: usize) -> Read {
        Read { first: 0, end: inputs }
    }

    /// True if the reading-age features are among them.
    pub(crate) const fn has_reading_age(self) -> bool {
        self.end > FEATURES
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Packed {
    /// Indices of the features read.
    pub(crate) read: Read,
    pub(crate) gelu: [[f32; 8]; 6],
    pub(crate) first: Dense<INPUTS, { HIDDEN[0] / LINE }>,
    pub(crate) second: Dense<{ HIDDEN[0] }, { HIDDEN[1] / LINE }>,
    pub(crate) third: Dense<{ HIDDEN[1] }, { HIDDEN[2] / LINE }>,
    pub(crate) last_weights: [f32; HIDDEN[2]],
    pub(crate) last_bias: f32,
}

impl Packed {
    /// The parameters must have passed the network's checks.
    pub(crate) fn new(parameters: &Parameters) -> Packed {
        let [first, second, third, last] = fold(parameters);
        Packed {
            read: Read { first: parameters.feature_set.first(), end: parameters.feature_set.end() },
            gelu: *parameters.activation.table(),
            first: Dense::new(&first, parameters.feature_set.range()),
            second: Dense::new(&second, 0..HIDDEN[0]),
            third: Dense::new(&third, 0..HIDDEN[1]),
            last_weights: std::array::from_fn(|i| last.weights[i]),
            last_bias: last.bias[0],
        }
    }
}

/// The layers as computed: the normalisation is folded in, so that the first takes features in
/// their units and the last gives watt, and so are the scale factors of GELU's segments. Double
/// precision, rounded once. The first biases compensate the rounding error of the weights at the
/// mean of the features, where most inputs are.
pub(crate) fn fold(parameters: &Parameters) -> [Layer; 4] {
    let [first, second, third, last] = &parameters.layers;
    let normalisation = &parameters.normalisation;
    let set = parameters.feature_set;
    let segments = f64::from(SCALE);
    let features = || set.range();
    let scale = |feature: usize| match normalisation.feature_std[feature] {
        std if std > 0.0 => segments / f64::from(std),
        _ => 0.0,
    };
    let in_segments = |bias: &f32| f64::from(*bias) * segments;

    let rows = first.weights.chunks(set.inputs());
    let weights = rows.flat_map(|row| row.iter().zip(features()));
    let weights = weights.map(|(&weight, feature)| (f64::from(weight) * scale(feature)) as f32);
    let weights: Vec<f32> = weights.collect();
    let shifted = |(bias, row): (&f32, &[f32])| {
        let at_mean = row.iter().zip(features()).map(|(&weight, feature)| {
            f64::from(weight) * f64::from(normalisation.feature_mean[feature])
        });
        (in_segments(bias) - at_mean.sum::<f64>()) as f32
    };
    let bias = first.bias.iter().zip(weights.chunks(set.inputs()));
    let bias = bias.map(shifted).collect();

    // 2 * segments in and segments out: a factor of 1/2, which is exact.
    let between = |layer: &Layer| Layer {
        weights: layer.weights.iter().map(|weight| weight * 0.5).collect(),
        bias: layer.bias.iter().map(|bias| in_segments(bias) as f32).collect(),
    };
    let std_w = f64::from(normalisation.power_std_w);
    let in_watt = |value: &f32| f64::from(*value) * std_w;
    let weight = |weight| (in_watt(weight) / (2.0 * segments)) as f32;
    let mean_w = f64::from(normalisation.power_mean_w);
    let last = Layer {
        weights: last.weights.iter().map(weight).collect(),
        bias: last.bias.iter().map(|bias| (in_watt(bias) + mean_w) as f32).collect(),
    };
    [Layer { weights, bias }, between(second), between(third), last]
}
