//! nalgebra with the error function of libm: a straightforward implementation. A column is a robot.

use nalgebra::{DMatrix, DVector};

use crate::input::Dense;
use crate::{Call, Forecaster};

#[derive(Clone)]
pub(crate) struct Nalgebra {
    layers: Vec<(DMatrix<f32>, DVector<f32>)>,
}

impl Nalgebra {
    pub(crate) fn load(layers: &[Dense]) -> Self {
        let layers = layers.iter().map(|layer| {
            let weights = DMatrix::from_row_slice(layer.outputs, layer.inputs, &layer.weights);
            (weights, DVector::from_column_slice(&layer.bias))
        });
        Self { layers: layers.collect() }
    }

    /// Memory for the values of each layer.
    fn scratch(&self, batch: usize) -> Vec<DMatrix<f32>> {
        let layers = self.layers.iter();
        layers.map(|(_, bias)| DMatrix::zeros(bias.len(), batch)).collect()
    }

    fn run(&self, input: &DMatrix<f32>, scratch: &mut [DMatrix<f32>]) {
        for (place, (weights, bias)) in self.layers.iter().enumerate() {
            let (before, from_here) = scratch.split_at_mut(place);
            let values = before.last().unwrap_or(input);
            let output = &mut from_here[0];
            for mut column in output.column_iter_mut() {
                column.copy_from(bias);
            }
            output.gemm(1.0, weights, values, 1.0);
            if place + 1 < self.layers.len() {
                output.apply(|x| {
                    *x = 0.5 * *x * (1.0 + libm::erff(*x * std::f32::consts::FRAC_1_SQRT_2));
                });
            }
        }
    }
}

fn columns(rows: &[[f32; 11]]) -> DMatrix<f32> {
    DMatrix::from_column_slice(11, rows.len(), rows.as_flattened())
}

impl Forecaster for Nalgebra {
    fn forecast(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Vec<f32>> {
        let mut scratch = self.scratch(rows.len());
        self.run(&columns(rows), &mut scratch);
        Ok(scratch[3].as_slice().to_vec())
    }

    fn call(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Call> {
        let (network, input) = (self.clone(), columns(rows));
        let mut scratch = self.scratch(rows.len());
        Ok(Box::new(move || {
            network.run(std::hint::black_box(&input), &mut scratch);
            std::hint::black_box(&mut scratch);
        }))
    }
}
