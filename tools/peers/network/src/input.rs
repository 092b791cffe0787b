//! Rows and weights, as `tools/peers/network.py` writes them: little-endian f32.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, ensure};
use joulebus_predictor::FEATURES;

/// Outputs and inputs of each layer.
const LAYERS: [(usize, usize); 4] = [(64, 11), (64, 64), (32, 64), (1, 32)];

/// A dense layer: `outputs` times `inputs` weights, row by row, and the biases.
pub(crate) struct Dense {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) weights: Vec<f32>,
    pub(crate) bias: Vec<f32>,
}

fn values(path: &Path) -> anyhow::Result<Vec<f32>> {
    let bytes = fs::read(path).with_context(|| path.display().to_string())?;
    let (words, rest) = bytes.as_chunks::<4>();
    ensure!(rest.is_empty(), "{} is truncated", path.display());
    Ok(words.iter().map(|word| f32::from_le_bytes(*word)).collect())
}

pub(crate) fn rows(path: &Path) -> anyhow::Result<Vec<[f32; FEATURES]>> {
    let values = values(path)?;
    let (rows, left) = values.as_chunks::<FEATURES>();
    ensure!(left.is_empty(), "{} is truncated", path.display());
    Ok(rows.to_vec())
}

/// The layers with the normalisation folded into the first and the last: the minimum work for
/// peers.
pub(crate) fn layers(path: &Path) -> anyhow::Result<Vec<Dense>> {
    let mut values = values(path)?.into_iter();
    let layers = LAYERS.map(|(outputs, inputs)| Dense {
        inputs,
        outputs,
        weights: values.by_ref().take(outputs * inputs).collect(),
        bias: values.by_ref().take(outputs).collect(),
    });
    let is_whole = layers.iter().all(|layer| layer.bias.len() == layer.outputs);
    ensure!(is_whole && values.next().is_none(), "{} has other layers", path.display());
    Ok(layers.into())
}
