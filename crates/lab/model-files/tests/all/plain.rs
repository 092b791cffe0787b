//! Plain networks, as `joulebus.models.convert` of the Python package writes them.

use std::collections::BTreeMap;

use joulebus_dataset::trial::Trial;
use joulebus_testkit_fleets::random::Noise;
use safetensors::tensor::{Dtype, TensorView};

/// Weights, one row per output, and biases of each layer.
pub(crate) type Layers = Vec<(Vec<f32>, Vec<f32>)>;

/// Layers of these widths, inputs first. The last one is small, so that a network that reads its own
/// forecasts does not diverge.
pub(crate) fn layers(widths: &[usize], seed: u64) -> Layers {
    let mut noise = Noise(seed);
    let pairs = widths.windows(2).map(|pair| {
        let scale = if pair[1] == 1 { 0.5 } else { 1.5 } / (pair[0] as f32).sqrt();
        let weights = (0..pair[0] * pair[1]).map(|_| noise.next_f32() * scale);
        let weights: Vec<f32> = weights.collect();
        let bias = (0..pair[1]).map(|_| noise.next_f32() * 0.3).collect();
        (weights, bias)
    });
    pairs.collect()
}

/// The contents of a plain network, to be changed and written.
#[derive(Clone)]
pub(crate) struct Contents {
    pub(crate) metadata: BTreeMap<String, String>,
    /// Shape and values of each tensor.
    pub(crate) tensors: BTreeMap<String, (Vec<usize>, Vec<f64>)>,
    pub(crate) dtype: Dtype,
}

impl Contents {
    /// `stated` are keys and values of the metadata. `inputs` and `power` are means and deviations.
    pub(crate) fn new(
        layers: &Layers,
        inputs: &[(f64, f64)],
        power: (f64, f64),
        stated: &[(&str, &str)],
    ) -> Contents {
        let mut tensors = BTreeMap::new();
        let double = |values: &[f32]| values.iter().map(|value| f64::from(*value)).collect();
        for (number, (weights, bias)) in layers.iter().enumerate() {
            let shape = vec![bias.len(), weights.len() / bias.len()];
            tensors.insert(format!("layers.{number}.weight"), (shape, double(weights)));
            tensors.insert(format!("layers.{number}.bias"), (vec![bias.len()], double(bias)));
        }
        let (mean, std): (Vec<f64>, Vec<f64>) = inputs.iter().copied().unzip();
        tensors.insert("feature_mean".to_owned(), (vec![mean.len()], mean));
        tensors.insert("feature_std".to_owned(), (vec![std.len()], std));
        tensors.insert("power_mean".to_owned(), (Vec::new(), vec![power.0]));
        tensors.insert("power_std".to_owned(), (Vec::new(), vec![power.1]));
        let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
        Contents { metadata: stated.iter().map(owned).collect(), tensors, dtype: Dtype::F64 }
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let encoded: Vec<(&str, &[usize], Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, (shape, values))| {
                let bytes = values.iter().flat_map(|value| match self.dtype {
                    Dtype::F32 => (*value as f32).to_le_bytes().to_vec(),
                    _ => value.to_le_bytes().to_vec(),
                });
                (name.as_str(), shape.as_slice(), bytes.collect())
            })
            .collect();
        let views = encoded.iter().map(|(name, shape, bytes)| {
            (*name, TensorView::new(self.dtype, shape.to_vec(), bytes).unwrap())
        });
        let metadata = self.metadata.clone().into_iter().collect();
        safetensors::serialize(views, Some(metadata)).unwrap()
    }
}

/// A trial from the text of a CSV file.
pub(crate) fn trial(csv: &str) -> Trial {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trial.csv");
    std::fs::write(&path, csv).unwrap();
    Trial::read(path).unwrap()
}
