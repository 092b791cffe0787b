//! candle: tensors layer by layer.

use candle_core::{D, Device, Tensor};

use crate::input::Dense;
use crate::{Call, Forecaster};

#[derive(Clone)]
pub(crate) struct Candle {
    /// Weights as inputs times outputs, and biases.
    layers: Vec<(Tensor, Tensor)>,
}

impl Candle {
    pub(crate) fn load(layers: &[Dense]) -> anyhow::Result<Self> {
        let cpu = &Device::Cpu;
        let layers = layers.iter().map(|layer| {
            let shape = (layer.outputs, layer.inputs);
            let weights = Tensor::from_slice(&layer.weights, shape, cpu)?.t()?.contiguous()?;
            let bias = Tensor::from_slice(&layer.bias, layer.outputs, cpu)?;
            Ok((weights, bias))
        });
        Ok(Self { layers: layers.collect::<anyhow::Result<_>>()? })
    }

    fn run(&self, input: &Tensor) -> candle_core::Result<Tensor> {
        let mut values = input.clone();
        for (place, (weights, bias)) in self.layers.iter().enumerate() {
            values = values.matmul(weights)?.broadcast_add(bias)?;
            if place + 1 < self.layers.len() {
                values = values.gelu_erf()?;
            }
        }
        values.squeeze(D::Minus1)
    }
}

fn tensor(rows: &[[f32; 11]]) -> candle_core::Result<Tensor> {
    Tensor::from_slice(rows.as_flattened(), (rows.len(), 11), &Device::Cpu)
}

impl Forecaster for Candle {
    fn forecast(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Vec<f32>> {
        Ok(self.run(&tensor(rows)?)?.to_vec1()?)
    }

    fn call(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Call> {
        let (network, input) = (self.clone(), tensor(rows)?);
        network.run(&input)?;
        Ok(Box::new(move || {
            std::hint::black_box(network.run(&input).expect("it ran before"));
        }))
    }
}
