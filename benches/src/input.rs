//! Inputs of the measurements, deterministic by seed.

use std::path::Path;

use anyhow::Context as _;
use joulebus_predictor::{Features, MAX_MODEL_BYTES, Network};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

pub(crate) const MODEL: &str = "gternal-sim";

/// The network of a model file, or the built-in one, with its name.
pub(crate) fn network(path: Option<&Path>) -> anyhow::Result<(String, Network)> {
    match path {
        None => {
            let (name, bytes) =
                joulebus_config::builtin_model(MODEL).context("there is no built-in model")?;
            Ok((format!("builtin:{name}"), Network::from_safetensors(bytes)?))
        }
        Some(path) => {
            let shown = path.display().to_string();
            let bytes = joulebus_files::read(path, MAX_MODEL_BYTES as u64)
                .with_context(|| format!("cannot read {shown}"))?;
            let network = Network::from_safetensors(&bytes)
                .with_context(|| format!("the model {shown} is refused"))?;
            Ok((shown, network))
        }
    }
}

/// Rows uniform over the training range, in SI units.
pub(crate) fn rows(network: &Network, seed: u64, count: usize) -> Vec<Features> {
    let range = &network.card().training_range;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let read = network.feature_set().range();
    let mut row = || {
        std::array::from_fn(|feature| {
            if !read.contains(&feature) {
                return 0.0;
            }
            let (min, max) = (range.min[feature], range.max[feature]);
            min + random.random::<f32>() * (max - min)
        })
    };
    (0..count).map(|_| row()).collect()
}

/// Minimum number of multiply-adds per forecast: the number of weights.
pub(crate) fn multiply_adds(network: &Network) -> usize {
    let layers = &network.parameters().layers;
    layers.iter().map(|layer| layer.weights.len()).sum()
}
