//! What goes into the measurements: the same from the same seed.

use std::fs;
use std::path::Path;

use anyhow::Context as _;
use joulebus_predictor::{Features, Network};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// The model that ships.
pub(crate) const MODEL: &str = "gternal-sim";

/// The network of a model file, or the one that ships, with its name.
///
/// # Errors
/// The file cannot be read or is refused.
pub(crate) fn network(path: Option<&Path>) -> anyhow::Result<(String, Network)> {
    match path {
        None => {
            let (name, bytes) =
                joulebus_config::builtin_model(MODEL).context("no model ships with the program")?;
            Ok((format!("builtin:{name}"), Network::from_safetensors(bytes)?))
        }
        Some(path) => {
            let shown = path.display().to_string();
            let bytes = fs::read(path).with_context(|| format!("cannot read {shown}"))?;
            let network = Network::from_safetensors(&bytes)
                .with_context(|| format!("the model {shown} is refused"))?;
            Ok((shown, network))
        }
    }
}

/// Rows spread evenly over the range in which the network was trained, in SI units.
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

/// Multiply-adds that one forecast of the network takes at least: its weights.
pub(crate) fn multiply_adds(network: &Network) -> usize {
    let layers = &network.parameters().layers;
    layers.iter().map(|layer| layer.weights.len()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_the_same_from_the_same_seed_and_lie_in_training() {
        let (_, network) = network(None).expect("a model ships");
        let rows_of = |seed| rows(&network, seed, 100);
        assert_eq!(rows_of(7), rows_of(7));
        assert_ne!(rows_of(7), rows_of(8));
        let range = network.card().training_range;
        for row in rows_of(7) {
            // A value at the very edge may be rounded past it.
            assert_eq!(range.outside(&row, 1e-6), None, "{row:?}");
        }
        assert_eq!(multiply_adds(&network), 11 * 64 + 64 * 64 + 64 * 32 + 32);
    }
}
