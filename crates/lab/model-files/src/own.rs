//! Joulebus models: as safetensors, or as the arrays that [`to_arrays`](super::to_arrays) and
//! [`to_onnx`](super::to_onnx) write.

use std::collections::HashMap;

use super::{Container, Entry, EntryValue, ReadError, Tensor};
use joulebus_predictor::{ModelError, Network};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};

/// The array with everything in the model file except the numbers of the network.
pub(super) const METADATA: &str = "metadata";
/// Prefix of the arrays for testing a reimplementation of the network.
pub(super) const CHECK: &str = "check_";

/// Array with the weights of features that were constant in training: they have no effect, and
/// `layers.0.weight` has zeros instead.
pub(super) const CONSTANT_WEIGHT: &str = "constant_feature_weight";

/// True if a file is safetensors: a length, then JSON.
pub(super) fn is_safetensors(bytes: &[u8]) -> bool {
    bytes.get(8) == Some(&b'{')
}

/// True if a safetensors file belongs to another program: a sound one without any of a model's
/// metadata. A damaged file is treated as a model, whose reader reports the damage.
pub(super) fn is_foreign(bytes: &[u8]) -> bool {
    let Ok((_, header)) = SafeTensors::read_metadata(bytes) else {
        return false;
    };
    let own = ["format_version", "kind", "convention", "sha256"];
    match header.metadata() {
        Some(fields) => own.iter().filter(|field| fields.contains_key(**field)).count() < 2,
        None => true,
    }
}

/// End of the header of a safetensors file, as stated in it.
pub(super) fn header_end(bytes: &[u8]) -> u64 {
    let length = bytes.first_chunk::<8>();
    length.map_or(0, |length| u64::from_le_bytes(*length).saturating_add(8))
}

/// The network's arrays, under the names that exported files have.
pub(super) fn entries(network: &Network) -> Vec<Entry> {
    let parameters = network.parameters();
    let set = parameters.feature_set;
    let normalisation = &parameters.normalisation;
    let is_constant = |feature: usize| normalisation.feature_std[feature] == 0.0;
    let mut entries = Vec::new();
    let mut add = |path: String, shape: Vec<usize>, values: &[f32]| {
        let value = EntryValue::Tensor(Tensor::from_f32(shape, values));
        entries.push(Entry { path, value });
    };
    for (number, layer) in parameters.layers.iter().enumerate() {
        let outputs = layer.bias.len();
        let inputs = layer.weights.len() / outputs;
        let mut weights = layer.weights.clone();
        if number == 0 && set.range().any(is_constant) {
            let columns = set.range().cycle().zip(&mut weights);
            let mut without_effect = vec![0.0; layer.weights.len()];
            for ((feature, weight), left_out) in columns.zip(&mut without_effect) {
                if is_constant(feature) {
                    *left_out = std::mem::take(weight);
                }
            }
            add(CONSTANT_WEIGHT.to_owned(), vec![outputs, inputs], &without_effect);
        }
        add(format!("layers.{number}.weight"), vec![outputs, inputs], &weights);
        add(format!("layers.{number}.bias"), vec![outputs], &layer.bias);
    }
    let range = &network.card().training_range;
    let mut feature_std = normalisation.feature_std;
    for std in feature_std.iter_mut().filter(|std| **std == 0.0) {
        *std = 1.0;
    }
    for (name, values) in [
        ("feature_mean", &normalisation.feature_mean),
        ("feature_std", &feature_std),
        ("feature_min", &range.min),
        ("feature_max", &range.max),
    ] {
        let values = &values[set.range()];
        add(name.to_owned(), vec![values.len()], values);
    }
    let (mean_w, std_w) = (normalisation.power_mean_w, normalisation.power_std_w);
    add("power_mean_w".to_owned(), Vec::new(), &[mean_w]);
    add("power_std_w".to_owned(), Vec::new(), &[std_w]);
    entries
}

/// The model, if these arrays are a joulebus model: reassembled as a model file and read as one, so
/// that it passes the same checks, the digest included. Arrays that contradict it are refused.
pub(super) fn from_arrays(
    container: Container,
    entries: &[Entry],
) -> Result<Option<Network>, ReadError> {
    if !matches!(container, Container::Npz | Container::Arrays) {
        return Ok(None);
    }
    let metadata = entries.iter().find(|entry| entry.path == METADATA);
    let Some(EntryValue::Text(metadata)) = metadata.map(|entry| &entry.value) else {
        return Ok(None);
    };
    let bad = |part: &str, detail: String| ReadError::Part {
        container,
        part: format!("array {part:?}"),
        detail,
    };
    let fields: HashMap<String, String> =
        serde_json::from_str(metadata).map_err(|error| bad(METADATA, error.to_string()))?;
    let network = Network::from_safetensors(&whole(entries, fields)?)?;
    for expected in self::entries(&network) {
        let found = entries.iter().find(|entry| entry.path == expected.path);
        if found.map(values) != Some(values(&expected)) {
            let detail = "is missing or contradicts the metadata".to_owned();
            return Err(bad(&expected.path, detail));
        }
    }
    Ok(Some(network))
}

/// The model file from which the arrays were exported.
pub(super) fn whole(
    entries: &[Entry],
    fields: HashMap<String, String>,
) -> Result<Vec<u8>, ReadError> {
    let constant = entries.iter().find(|entry| entry.path == CONSTANT_WEIGHT);
    let constant = constant.and_then(values).map_or(&[][..], |(_, values)| values);
    let layers = entries.iter().filter_map(|entry| match &entry.value {
        EntryValue::Tensor(tensor) if entry.path.starts_with("layers.") => {
            let left_out = match entry.path.as_str() {
                "layers.0.weight" => constant,
                _ => &[],
            };
            let left_out = left_out.iter().copied().chain(std::iter::repeat(0.0));
            // Compared by bits, because a weight may be a negative zero.
            let bytes = tensor.values().iter().zip(left_out).flat_map(|(value, left_out)| {
                let value = if left_out.to_bits() == 0 { *value } else { left_out };
                (value as f32).to_le_bytes()
            });
            Some((entry.path.as_str(), tensor.shape(), bytes.collect()))
        }
        _ => None,
    });
    let layers: Vec<(&str, &[usize], Vec<u8>)> = layers.collect();
    let mut views = Vec::new();
    for (name, shape, bytes) in &layers {
        let view = TensorView::new(Dtype::F32, shape.to_vec(), bytes).map_err(ModelError::from)?;
        views.push((*name, view));
    }
    Ok(safetensors::serialize(views, Some(fields)).map_err(ModelError::from)?)
}

fn values(entry: &Entry) -> Option<(&[usize], &[f64])> {
    match &entry.value {
        EntryValue::Tensor(tensor) => Some((tensor.shape(), tensor.values())),
        _ => None,
    }
}

/// The metadata of a model file, as JSON with sorted keys.
pub(super) fn metadata(file: &[u8]) -> Result<String, ModelError> {
    let (_, header) = SafeTensors::read_metadata(file)?;
    let empty = HashMap::new();
    let fields = header.metadata().as_ref().unwrap_or(&empty);
    // `Value` sorts its keys, so the same model gives the same bytes.
    Ok(serde_json::json!(fields).to_string())
}
