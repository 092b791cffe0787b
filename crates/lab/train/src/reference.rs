//! The network in double precision, forward and backward, one row at a time: the slow reference of
//! the trainer's tests.

use joulebus_predictor::HIDDEN;
use nalgebra::{DMatrixView, DVector, DVectorView};

/// Squared error of one row of normalised inputs, and its gradients, in the order of the trainer's
/// weights `values`. `kept(layer, j)` is the dropout factor of value `j` of a hidden layer.
pub(super) fn squared_error(
    values: &[f64],
    inputs: &[f64],
    target: f64,
    kept: impl Fn(usize, usize) -> f64,
) -> (f64, Vec<f64>) {
    // A layer is stored input by input, which is column by column, then its biases.
    let mut layers = Vec::new();
    let (mut columns, mut rest) = (inputs.len(), values);
    for rows in HIDDEN.into_iter().chain([1]) {
        let (matrix, behind) = rest.split_at(rows * columns);
        let (bias, behind) = behind.split_at(rows);
        layers.push((
            DMatrixView::from_slice(matrix, rows, columns),
            DVectorView::from_slice(bias, rows),
        ));
        (columns, rest) = (rows, behind);
    }
    assert!(rest.is_empty(), "{} weights too many", rest.len());

    // Inputs of each layer, and the slopes of those that are hidden values.
    let mut activations = vec![DVector::from_column_slice(inputs)];
    let mut slopes = Vec::new();
    for (layer, (matrix, bias)) in layers.iter().enumerate() {
        let sums = matrix * &activations[layer] + bias;
        let kept = |j| if layer < HIDDEN.len() { kept(layer, j) } else { 1.0 };
        slopes.push(sums.map_with_location(|j, _, sum| gelu_and_slope(sum).1 * kept(j)));
        activations.push(match layer {
            _ if layer == HIDDEN.len() => sums,
            _ => sums.map_with_location(|j, _, sum| gelu_and_slope(sum).0 * kept(j)),
        });
    }

    let error = activations[layers.len()][0] - target;
    let mut back = DVector::from_element(1, 2.0 * error);
    let mut parts = Vec::new();
    for (layer, (matrix, _)) in layers.iter().enumerate().rev() {
        let of_matrix = &back * activations[layer].transpose();
        parts.push([of_matrix.as_slice(), back.as_slice()].concat());
        if layer > 0 {
            back = matrix.tr_mul(&back).component_mul(&slopes[layer - 1]);
        }
    }
    parts.reverse();
    (error * error, parts.concat())
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
    use joulebus_statistics::noise::Noise;

    #[test]
    fn gradients_agree_with_finite_differences_with_and_without_dropout() {
        let mut noise = Noise::new(1, 0);
        let mut weights: Vec<f64> = (0..11 * 64 + 64 + 64 * 64 + 64 + 64 * 32 + 32 + 32 + 1)
            .map(|_| noise.between(-0.2, 0.2))
            .collect();
        for share in [0.0, 0.3] {
            let kept: [[f64; HIDDEN[0]]; HIDDEN.len()] = std::array::from_fn(|_| {
                std::array::from_fn(|_| f64::from(noise.uniform() >= share) / (1.0 - share))
            });
            let kept = |layer: usize, j: usize| kept[layer][j];
            let inputs: Vec<f64> = (0..11).map(|_| noise.normal()).collect();
            let target = noise.normal();
            let (_, gradients) = squared_error(&weights, &inputs, target, kept);
            let mut not_zero = 0;
            for position in (0..gradients.len()).step_by(13).chain([gradients.len() - 1]) {
                let step = 1e-5;
                let mut loss = |shift: f64| {
                    let before = weights[position];
                    weights[position] = before + shift;
                    let (loss, _) = squared_error(&weights, &inputs, target, kept);
                    weights[position] = before;
                    loss
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
