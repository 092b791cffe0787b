//! The network in double precision, forward and backward, one row at a time: the slow reference of
//! the trainer's tests.

use joulebus_predictor::HIDDEN;
use joulebus_statistics::noise::Noise;

const LAYERS: usize = HIDDEN.len() + 1;
const WIDEST: usize = HIDDEN[0];

/// All weights and biases in one vector. A layer is stored as its weights, input by input (so that
/// the forward loop runs over contiguous outputs), then its biases.
#[derive(Clone, Debug)]
pub(super) struct Weights {
    pub(super) values: Vec<f64>,
    shapes: [Shape; LAYERS],
}

#[derive(Clone, Copy, Debug)]
struct Shape {
    inputs: usize,
    outputs: usize,
    start: usize,
}

impl Shape {
    fn split<'a>(&self, values: &'a [f64]) -> (&'a [f64], &'a [f64]) {
        let end = self.start + (self.inputs + 1) * self.outputs;
        values[self.start..end].split_at(self.inputs * self.outputs)
    }

    fn split_mut<'a>(&self, values: &'a mut [f64]) -> (&'a mut [f64], &'a mut [f64]) {
        let end = self.start + (self.inputs + 1) * self.outputs;
        values[self.start..end].split_at_mut(self.inputs * self.outputs)
    }
}

impl Weights {
    /// Uniform within ±1/√inputs, the usual initialisation of dense layers.
    pub(super) fn initial(inputs: usize, noise: &mut Noise) -> Weights {
        let [first, second, third] = HIDDEN;
        let mut values = Vec::new();
        let sizes = [(inputs, first), (first, second), (second, third), (third, 1)];
        let shapes = sizes.map(|(inputs, outputs)| {
            let start = values.len();
            let bound = 1.0 / libm::sqrt(inputs as f64);
            let count = (inputs + 1) * outputs;
            values.extend((0..count).map(|_| noise.between(-bound, bound)));
            Shape { inputs, outputs, start }
        });
        Weights { values, shapes }
    }

    /// The trainer's weights, which have the same order.
    pub(super) fn from_f32(inputs: usize, values: &[f32]) -> Weights {
        let mut weights = Weights::initial(inputs, &mut Noise::new(0, 0));
        assert_eq!(weights.values.len(), values.len());
        weights.values = values.iter().map(|value| f64::from(*value)).collect();
        weights
    }
}

/// Intermediate results of a row.
pub(super) struct Workspace {
    /// Gradients of the summed loss since they were last zeroed, in the order of the weights.
    pub(super) gradients: Vec<f64>,
    /// Dropout factor of each hidden value: 0, or the factor that preserves the mean.
    kept: [[f64; WIDEST]; HIDDEN.len()],
    outputs: [[f64; WIDEST]; HIDDEN.len()],
    slopes: [[f64; WIDEST]; HIDDEN.len()],
}

impl Workspace {
    pub(super) fn new(weights: &Weights) -> Workspace {
        Workspace {
            gradients: vec![0.0; weights.values.len()],
            kept: [[1.0; WIDEST]; HIDDEN.len()],
            outputs: [[0.0; WIDEST]; HIDDEN.len()],
            slopes: [[0.0; WIDEST]; HIDDEN.len()],
        }
    }

    /// Sets the dropout factor of value `j` of a hidden layer: `kept(layer, j)`.
    pub(super) fn keep(&mut self, mut kept: impl FnMut(usize, usize) -> f64) {
        for (layer, width) in HIDDEN.into_iter().enumerate() {
            for j in 0..width {
                self.kept[layer][j] = kept(layer, j);
            }
        }
    }

    /// The normalised forecast for one row of normalised inputs.
    pub(super) fn forward(&mut self, weights: &Weights, inputs: &[f64]) -> f64 {
        let mut sums = [0.0; WIDEST];
        for (number, shape) in weights.shapes.iter().enumerate() {
            let (matrix, bias) = shape.split(&weights.values);
            let sums = &mut sums[..shape.outputs];
            sums.copy_from_slice(bias);
            let before = match number {
                0 => inputs,
                _ => &self.outputs[number - 1][..shape.inputs],
            };
            for (x, weights) in before.iter().zip(matrix.chunks_exact(shape.outputs)) {
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum += x * weight;
                }
            }
            if number < HIDDEN.len() {
                for (j, &sum) in sums.iter().enumerate() {
                    let (value, slope) = gelu_and_slope(sum);
                    let kept = self.kept[number][j];
                    self.outputs[number][j] = value * kept;
                    self.slopes[number][j] = slope * kept;
                }
            }
        }
        sums[0]
    }

    /// Adds the gradients of the squared error of one row and returns that error.
    pub(super) fn accumulate(&mut self, weights: &Weights, inputs: &[f64], target: f64) -> f64 {
        let error = self.forward(weights, inputs) - target;
        let mut back = [0.0; WIDEST];
        back[0] = 2.0 * error;
        for (number, shape) in weights.shapes.iter().enumerate().rev() {
            let (matrix, _) = shape.split(&weights.values);
            let (matrix_gradients, bias_gradients) = shape.split_mut(&mut self.gradients);
            let before = match number {
                0 => inputs,
                _ => &self.outputs[number - 1][..shape.inputs],
            };
            let from = back;
            let from = &from[..shape.outputs];
            for (gradient, from) in bias_gradients.iter_mut().zip(from) {
                *gradient += from;
            }
            for (x, gradients) in
                before.iter().zip(matrix_gradients.chunks_exact_mut(shape.outputs))
            {
                for (gradient, from) in gradients.iter_mut().zip(from) {
                    *gradient += x * from;
                }
            }
            if number > 0 {
                let slopes = &self.slopes[number - 1];
                let rows = matrix.chunks_exact(shape.outputs).zip(slopes);
                for (back, (weights, slope)) in back.iter_mut().zip(rows) {
                    *back = slope * dot(weights, from);
                }
            }
        }
        error * error
    }
}

/// Four partial sums in a fixed order: fast and the same on every machine.
fn dot(left: &[f64], right: &[f64]) -> f64 {
    let (left_fours, left_rest) = left.as_chunks::<4>();
    let (right_fours, right_rest) = right.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (left, right) in left_fours.iter().zip(right_fours) {
        for lane in 0..4 {
            sums[lane] += left[lane] * right[lane];
        }
    }
    let rest: f64 = left_rest.iter().zip(right_rest).map(|(x, y)| x * y).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

fn gelu_and_slope(x: f64) -> (f64, f64) {
    let below = 0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2);
    let density = libm::exp(-0.5 * x * x)
        * (0.5 * std::f64::consts::FRAC_2_SQRT_PI)
        * std::f64::consts::FRAC_1_SQRT_2;
    (x * below, below + x * density)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_agree_with_finite_differences_with_and_without_dropout() {
        let mut noise = Noise::new(1, 0);
        let mut weights = Weights::initial(11, &mut noise);
        let mut workspace = Workspace::new(&weights);
        for share in [0.0, 0.3] {
            let scale = 1.0 / (1.0 - share);
            workspace.keep(|_, _| if noise.uniform() < share { 0.0 } else { scale });
            let inputs: Vec<f64> = (0..11).map(|_| noise.normal()).collect();
            let target = noise.normal();
            workspace.gradients.fill(0.0);
            workspace.accumulate(&weights, &inputs, target);
            let gradients = workspace.gradients.clone();
            let mut not_zero = 0;
            for position in (0..gradients.len()).step_by(13).chain([gradients.len() - 1]) {
                let step = 1e-5;
                let mut loss = |shift: f64| {
                    let before = weights.values[position];
                    weights.values[position] = before + shift;
                    let error = workspace.forward(&weights, &inputs) - target;
                    weights.values[position] = before;
                    error * error
                };
                let slope = (loss(step) - loss(-step)) / (2.0 * step);
                let difference = (slope - gradients[position]).abs();
                assert!(difference < 1e-7 + 1e-6 * slope.abs(), "{position}: {difference:e}");
                not_zero += usize::from(slope.abs() > 1e-6);
            }
            assert!(not_zero > 100, "{not_zero} gradients are not zero");
        }
    }
}
