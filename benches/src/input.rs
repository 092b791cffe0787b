//! Inputs of the measurements, the same in every run.

use anyhow::Context as _;
use joulebus_predictor::{Features, Network};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

pub(crate) const MODEL: &str = "gternal-sim";
pub(crate) const SEED: u64 = 7;
/// Frames per second of a paced measurement.
pub(crate) const RATE_HZ: u64 = 30;

/// The built-in network.
pub(crate) fn network() -> anyhow::Result<Network> {
    let (_, bytes) = joulebus_config::builtin_model(MODEL).context("there is no built-in model")?;
    Ok(Network::from_safetensors(bytes)?)
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
