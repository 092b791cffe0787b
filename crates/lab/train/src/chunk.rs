//! Forward and backward pass of a part of a batch.
//!
//! A batch is always cut into the same parts, and their gradients are added in the same order, so
//! the number of threads changes no bit.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use joulebus_predictor::HIDDEN;

use super::kernels::{LANES, Left, add_product, gelu_and_slope};
use super::weights::{LAYERS, Weights, transpose};
use joulebus_statistics::noise::Noise;

/// Rows of a part.
pub(super) const ROWS: usize = 32;
/// Inputs per row, padded: up to thirteen features, then zeros.
pub(super) const PADDED_INPUTS: usize = LANES;
const WIDEST: usize = HIDDEN[0];

/// A normalised row.
#[derive(Clone, Debug)]
pub(super) struct Example {
    /// The features that the network reads, then zeros.
    pub inputs: [f32; PADDED_INPUTS],
    pub target: f32,
}

/// The weights, with transposed copies of the middle layers' weights.
pub(super) struct Prepared {
    turned: [Vec<f32>; LAYERS],
}

impl Prepared {
    pub(super) fn new(weights: &Weights) -> Self {
        let mut prepared =
            Self { turned: weights.shapes.map(|shape| vec![0.0; shape.inputs * shape.outputs]) };
        prepared.update(weights);
        prepared
    }

    pub(super) fn update(&mut self, weights: &Weights) {
        for (shape, turned) in weights.shapes.iter().zip(&mut self.turned) {
            transpose(shape.split(&weights.values).0, shape.outputs, turned);
        }
    }
}

/// Intermediate results of a part.
pub(super) struct Chunk {
    /// Gradients of the summed loss, in the order of the weights.
    pub gradients: Vec<f32>,
    inputs: Vec<f32>,
    /// For each hidden layer: the dropout factor of each value (0, or the factor that preserves the
    /// mean), its values, and the slope of each activation.
    kept: [Vec<f32>; HIDDEN.len()],
    values: [Vec<f32>; HIDDEN.len()],
    slopes: [Vec<f32>; HIDDEN.len()],
    /// Gradients of the loss with respect to the pre-activations of the current layer and of the
    /// one before.
    back: Vec<f32>,
    before: Vec<f32>,
    forecasts: [f32; ROWS],
}

impl Chunk {
    pub(super) fn new(weights: &Weights) -> Self {
        let hidden = || HIDDEN.map(|width| vec![0.0; ROWS * width]);
        Self {
            gradients: vec![0.0; weights.values.len()],
            inputs: vec![0.0; ROWS * PADDED_INPUTS],
            kept: HIDDEN.map(|width| vec![1.0; ROWS * width]),
            values: hidden(),
            slopes: hidden(),
            back: vec![0.0; ROWS * WIDEST],
            before: vec![0.0; ROWS * WIDEST],
            forecasts: [0.0; ROWS],
        }
    }

    /// Draws the dropout mask. A share of `dropped` in 65,536 is dropped.
    pub(super) fn draw_dropout(&mut self, dropped: u16, rows: usize, noise: &mut Noise) {
        let scale = 65_536.0 / (65_536.0 - f32::from(dropped));
        for (kept, width) in self.kept.iter_mut().zip(HIDDEN) {
            for four in kept[..rows * width].as_chunks_mut::<4>().0 {
                let mut bits = noise.bits();
                for kept in four {
                    *kept = if (bits as u16) < dropped { 0.0 } else { scale };
                    bits >>= 16;
                }
            }
        }
    }

    pub(super) fn keep_everything(&mut self) {
        self.kept.iter_mut().for_each(|kept| kept.fill(1.0));
    }

    /// Forward and backward pass of up to [`ROWS`] rows: computes the gradients, and returns the
    /// summed loss.
    #[inline(always)]
    pub(super) fn learn<'e, S: Simd>(
        &mut self,
        simd: S,
        weights: &Weights,
        prepared: &Prepared,
        rows: impl ExactSizeIterator<Item = &'e Example> + Clone,
    ) -> f64 {
        let loss = self.measure(simd, weights, rows.clone());
        let count = rows.len();
        for (forecast, row) in self.forecasts.iter_mut().zip(rows) {
            *forecast = 2.0 * (*forecast - row.target);
        }
        self.gradients.fill(0.0);
        self.turn(simd, weights, count);
        for layer in (0..HIDDEN.len()).rev() {
            self.back_through(simd, weights, prepared, layer, count);
        }
        loss
    }

    /// Forward pass of up to [`ROWS`] rows. Returns the summed loss.
    #[inline(always)]
    pub(super) fn measure<'e, S: Simd>(
        &mut self,
        simd: S,
        weights: &Weights,
        rows: impl ExactSizeIterator<Item = &'e Example> + Clone,
    ) -> f64 {
        let count = rows.len();
        for (place, row) in self.inputs.chunks_exact_mut(PADDED_INPUTS).zip(rows.clone()) {
            place.copy_from_slice(&row.inputs);
        }
        for layer in 0..HIDDEN.len() {
            self.forward(simd, weights, layer, count);
        }
        let (last, bias) = weights.shapes[HIDDEN.len()].split(&weights.values);
        let values = self.values[HIDDEN.len() - 1].chunks_exact(last.len());
        let mut loss = 0.0;
        for ((forecast, values), row) in self.forecasts.iter_mut().zip(values).zip(rows) {
            *forecast = bias[0] + dot(simd, values, last);
            let error = f64::from(*forecast - row.target);
            loss += error * error;
        }
        loss
    }

    #[inline(always)]
    fn forward<S: Simd>(&mut self, simd: S, weights: &Weights, layer: usize, count: usize) {
        let shape = weights.shapes[layer];
        let (matrix, bias) = shape.split(&weights.values);
        let (below, here) = self.values.split_at_mut(layer);
        let (input, step) = match below.last() {
            None => (&self.inputs, PADDED_INPUTS),
            Some(values) => (values, shape.inputs),
        };
        let values = &mut here[0][..count * shape.outputs];
        for line in values.chunks_exact_mut(shape.outputs) {
            line.copy_from_slice(bias);
        }
        let left = Left { values: input, row_step: step, inner_step: 1 };
        add_product(simd, left, matrix, shape.outputs, values);
        let slopes = self.slopes[layer].chunks_exact_mut(LANES);
        let kept = self.kept[layer].chunks_exact(LANES);
        for ((value, slope), kept) in values.chunks_exact_mut(LANES).zip(slopes).zip(kept) {
            let kept = f32x16::from_slice(simd, kept);
            let (gelu, steep) = gelu_and_slope(simd, f32x16::from_slice(simd, value));
            (gelu * kept).store_slice(value);
            (steep * kept).store_slice(slope);
        }
    }

    /// Backward pass from the gradients of the forecasts to those of the last layer's weights and
    /// of the last hidden layer's pre-activations.
    #[inline(always)]
    fn turn<S: Simd>(&mut self, simd: S, weights: &Weights, count: usize) {
        let shape = weights.shapes[HIDDEN.len()];
        let (last, _) = shape.split(&weights.values);
        let (matrix, bias) = shape.split_mut(&mut self.gradients);
        let (values, slopes) = (&self.values[HIDDEN.len() - 1], &self.slopes[HIDDEN.len() - 1]);
        for (row, forecast) in self.forecasts[..count].iter().enumerate() {
            bias[0] += forecast;
            let by_forecast = f32x16::splat(simd, *forecast);
            for at in (0..shape.inputs).step_by(LANES) {
                let place = row * shape.inputs + at;
                let value = f32x16::from_slice(simd, &values[place..][..LANES]);
                let slope = f32x16::from_slice(simd, &slopes[place..][..LANES]);
                let weight = f32x16::from_slice(simd, &last[at..][..LANES]);
                let gradient = &mut matrix[at..][..LANES];
                let so_far = f32x16::from_slice(simd, gradient);
                let sum = value.mul_add_precise(by_forecast, so_far);
                sum.store_slice(gradient);
                let back = by_forecast * weight * slope;
                back.store_slice(&mut self.back[place..][..LANES]);
            }
        }
    }

    /// Backward pass from the gradients of a hidden layer's pre-activations to those of its weights
    /// and of the previous layer's pre-activations.
    #[inline(always)]
    fn back_through<S: Simd>(
        &mut self,
        simd: S,
        weights: &Weights,
        prepared: &Prepared,
        layer: usize,
        count: usize,
    ) {
        let shape = weights.shapes[layer];
        let back = &self.back[..count * shape.outputs];
        let (matrix, bias) = shape.split_mut(&mut self.gradients);
        let ones = Left { values: &[1.0], row_step: 0, inner_step: 0 };
        add_product(simd, ones, back, shape.outputs, bias);
        let (input, step) = match layer {
            0 => (&self.inputs, PADDED_INPUTS),
            _ => (&self.values[layer - 1], shape.inputs),
        };
        let turned_input = Left { values: input, row_step: 1, inner_step: step };
        add_product(simd, turned_input, back, shape.outputs, matrix);
        if layer == 0 {
            return;
        }
        let before = &mut self.before[..count * shape.inputs];
        before.fill(0.0);
        let left = Left { values: back, row_step: shape.outputs, inner_step: 1 };
        add_product(simd, left, &prepared.turned[layer], shape.inputs, before);
        for (before, slope) in
            before.chunks_exact_mut(LANES).zip(self.slopes[layer - 1].chunks_exact(LANES))
        {
            let product = f32x16::from_slice(simd, before) * f32x16::from_slice(simd, slope);
            product.store_slice(before);
        }
        std::mem::swap(&mut self.back, &mut self.before);
    }
}

/// Sixteen partial sums, added pairwise.
#[inline(always)]
fn dot<S: Simd>(simd: S, left: &[f32], right: &[f32]) -> f32 {
    let mut sums = f32x16::splat(simd, 0.0);
    for (left, right) in left.chunks_exact(LANES).zip(right.chunks_exact(LANES)) {
        sums =
            f32x16::from_slice(simd, left).mul_add_precise(f32x16::from_slice(simd, right), sums);
    }
    let mut sums: [f32; LANES] = *sums.as_array();
    let mut width = LANES / 2;
    while width > 0 {
        for lane in 0..width {
            sums[lane] += sums[lane + width];
        }
        width /= 2;
    }
    sums[0]
}

#[cfg(test)]
mod tests {
    use super::super::reference;
    use super::*;
    use fearless_simd::{Level, dispatch};
    use nalgebra::DVector;

    /// A part of `count` rows in both precisions: summed losses and gradients.
    fn both(
        count: usize,
        inputs: usize,
        dropped: u16,
        level: Level,
    ) -> ((f64, Vec<f32>), (f64, Vec<f64>)) {
        let mut noise = Noise::new(count as u64, 3);
        let weights = Weights::initial(inputs, &mut noise);
        let rows: Vec<Example> =
            (0..count)
                .map(|_| Example {
                    inputs: std::array::from_fn(|i| {
                        if i < inputs { noise.normal() as f32 } else { 0.0 }
                    }),
                    target: noise.normal() as f32,
                })
                .collect();
        let (mut chunk, prepared) = (Chunk::new(&weights), Prepared::new(&weights));
        chunk.draw_dropout(dropped, count, &mut noise);
        let loss = dispatch!(level, simd => chunk.learn(simd, &weights, &prepared, rows.iter()));

        let slow: Vec<f64> = weights.values.iter().map(|weight| f64::from(*weight)).collect();
        let (mut expected, mut gradients) = (0.0, DVector::zeros(slow.len()));
        for (row, example) in rows.iter().enumerate() {
            let kept =
                |layer: usize, j: usize| f64::from(chunk.kept[layer][row * HIDDEN[layer] + j]);
            let inputs: Vec<f64> = example.inputs[..inputs].iter().map(|x| f64::from(*x)).collect();
            let (error, of_row) =
                reference::squared_error(&slow, &inputs, f64::from(example.target), kept);
            expected += error;
            gradients += DVector::from_vec(of_row);
        }
        ((loss, chunk.gradients), (expected, gradients.as_slice().to_vec()))
    }

    #[test]
    fn gradients_of_a_part_agree_with_double_precision_row_by_row() {
        for count in [1, 2, 3, 5, 31, ROWS] {
            for inputs in [5, 11] {
                for dropped in [0, 6_554] {
                    let ((loss, found), (expected_loss, expected)) =
                        both(count, inputs, dropped, Level::new());
                    assert!((loss - expected_loss).abs() < 1e-5 * expected_loss, "{loss}");
                    let largest = expected.iter().fold(0.0, |most: f64, g| most.max(g.abs()));
                    for (place, (found, expected)) in found.iter().zip(&expected).enumerate() {
                        let difference = (f64::from(*found) - expected).abs();
                        assert!(
                            difference < 3e-6 * largest,
                            "{count} rows, {inputs} inputs, {place}: {found} {expected}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn every_vector_width_gives_the_same_bits() {
        let all = both(29, 11, 6_554, Level::new()).0;
        let narrow = both(29, 11, 6_554, Level::baseline()).0;
        assert_eq!(all.0.to_bits(), narrow.0.to_bits());
        let bits =
            |gradients: &[f32]| -> Vec<u32> { gradients.iter().map(|g| g.to_bits()).collect() };
        assert_eq!(bits(&all.1), bits(&narrow.1));
    }

    #[test]
    fn dropout_drops_its_share_and_preserves_the_mean() {
        let weights = Weights::initial(11, &mut Noise::new(1, 1));
        let mut chunk = Chunk::new(&weights);
        chunk.draw_dropout(6_554, ROWS, &mut Noise::new(2, 2));
        for kept in &chunk.kept {
            let dropped = kept.iter().filter(|kept| **kept == 0.0).count() as f64;
            let share = dropped / kept.len() as f64;
            assert!((0.07..0.13).contains(&share), "{share}");
        }
        let values: Vec<f32> = chunk.kept.concat();
        let scale = values.iter().fold(0.0, |most: f32, kept| most.max(*kept));
        assert!((f64::from(scale) * (1.0 - 6_554.0 / 65_536.0) - 1.0).abs() < 1e-6);
        assert!(values.iter().all(|kept| *kept == 0.0 || *kept == scale));
    }
}
