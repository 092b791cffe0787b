//! Rows and weights.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, ensure};
use joulebus_predictor::{FEATURES, FeatureSet, Network};

/// A dense layer: `outputs` times `inputs` weights, row by row, and the biases.
pub(crate) struct Dense {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) weights: Vec<f32>,
    pub(crate) bias: Vec<f32>,
}

pub(crate) fn rows(path: &Path) -> anyhow::Result<Vec<[f32; FEATURES]>> {
    let bytes = fs::read(path).with_context(|| path.display().to_string())?;
    let (words, rest) = bytes.as_chunks::<4>();
    let values: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
    let (rows, left) = values.as_chunks::<FEATURES>();
    ensure!(rest.is_empty() && left.is_empty(), "{} is truncated", path.display());
    Ok(rows.to_vec())
}

pub(crate) fn network(path: &Path) -> anyhow::Result<Network> {
    let bytes = fs::read(path).with_context(|| path.display().to_string())?;
    let network = Network::from_safetensors(&bytes)?;
    ensure!(network.feature_set() == FeatureSet::Full, "a network of all features");
    Ok(network)
}

/// The layers with the normalisation folded into the first and the last: the minimum work for
/// peers.
pub(crate) fn layers(path: &Path) -> anyhow::Result<Vec<Dense>> {
    let network = network(path)?;
    let parameters = network.parameters();
    let scale = &parameters.normalisation;
    let mut layers: Vec<Dense> = parameters
        .layers
        .iter()
        .map(|layer| Dense {
            inputs: layer.weights.len() / layer.bias.len(),
            outputs: layer.bias.len(),
            weights: layer.weights.clone(),
            bias: layer.bias.clone(),
        })
        .collect();
    let first = &mut layers[0];
    for (weights, bias) in first.weights.chunks_mut(FEATURES).zip(&mut first.bias) {
        let mut shift = 0.0_f64;
        for (feature, weight) in weights.iter_mut().enumerate() {
            let std = f64::from(scale.feature_std[feature]);
            let folded = if std > 0.0 { f64::from(*weight) / std } else { 0.0 };
            shift += folded * f64::from(scale.feature_mean[feature]);
            *weight = folded as f32;
        }
        *bias = (f64::from(*bias) - shift) as f32;
    }
    let last = &mut layers[3];
    for weight in &mut last.weights {
        *weight *= scale.power_std_w;
    }
    last.bias[0] = last.bias[0].mul_add(scale.power_std_w, scale.power_mean_w);
    Ok(layers)
}
