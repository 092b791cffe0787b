//! All weights and biases in one vector.

use joulebus_predictor::{HIDDEN, Layer};

use joulebus_statistics::noise::Noise;

pub(super) const LAYERS: usize = HIDDEN.len() + 1;

/// Position of a layer: its weights, input by input (so that contiguous numbers belong to adjacent
/// outputs), then its biases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub inputs: usize,
    pub outputs: usize,
    start: usize,
}

impl Shape {
    /// Weights and biases of the layer.
    pub(super) fn split<'a>(&self, values: &'a [f32]) -> (&'a [f32], &'a [f32]) {
        let end = self.start + (self.inputs + 1) * self.outputs;
        values[self.start..end].split_at(self.inputs * self.outputs)
    }

    pub(super) fn split_mut<'a>(&self, values: &'a mut [f32]) -> (&'a mut [f32], &'a mut [f32]) {
        let end = self.start + (self.inputs + 1) * self.outputs;
        values[self.start..end].split_at_mut(self.inputs * self.outputs)
    }
}

/// The layers of a network that reads `inputs` features.
pub(super) fn shapes(inputs: usize) -> [Shape; LAYERS] {
    let [first, second, third] = HIDDEN;
    let sizes = [(inputs, first), (first, second), (second, third), (third, 1)];
    let mut start = 0;
    sizes.map(|(inputs, outputs)| {
        let shape = Shape { inputs, outputs, start };
        start += (inputs + 1) * outputs;
        shape
    })
}

/// Weights and biases, f32 as the predictor has them.
#[derive(Clone, Debug)]
pub(super) struct Weights {
    pub values: Vec<f32>,
    pub shapes: [Shape; LAYERS],
}

impl Weights {
    /// Uniform within ±1/√inputs, the usual initialisation of dense layers.
    pub(super) fn initial(inputs: usize, noise: &mut Noise) -> Self {
        let shapes = shapes(inputs);
        let mut values = Vec::new();
        for shape in &shapes {
            let bound = 1.0 / libm::sqrt(shape.inputs as f64);
            let count = (shape.inputs + 1) * shape.outputs;
            values.extend((0..count).map(|_| noise.between(-bound, bound) as f32));
        }
        Self { values, shapes }
    }

    /// The layers in the predictor's order: output by output.
    pub(super) fn layers(&self) -> [Layer; LAYERS] {
        self.shapes.map(|shape| {
            let (matrix, bias) = shape.split(&self.values);
            let mut weights = vec![0.0; matrix.len()];
            transpose(matrix, shape.outputs, &mut weights);
            Layer { weights, bias: bias.to_vec() }
        })
    }
}

/// Transposes rows of `columns` numbers.
pub(super) fn transpose(from: &[f32], columns: usize, to: &mut [f32]) {
    let rows = from.len() / columns;
    for (row, line) in from.chunks_exact(columns).enumerate() {
        for (column, value) in line.iter().enumerate() {
            to[column * rows + row] = *value;
        }
    }
}
