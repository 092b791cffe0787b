//! The numbers of a network, under the names that exported files have.

use std::collections::BTreeMap;

use joulebus_predictor::{ModelError, Network};
use safetensors::SafeTensors;

/// An array of numbers.
pub(super) struct Array {
    pub(super) name: String,
    pub(super) shape: Vec<usize>,
    /// In C order.
    pub(super) values: Vec<f32>,
}

/// The array with everything in the model file except the numbers of the network.
pub(super) const METADATA: &str = "metadata";
/// Prefix of the arrays for testing a reimplementation of the network.
pub(super) const CHECK: &str = "check_";

/// Array with the weights of features that were constant in training: they have no effect, and
/// `layers.0.weight` has zeros instead.
pub(super) const CONSTANT_WEIGHT: &str = "constant_feature_weight";

/// The network's arrays, under the names that exported files have.
pub(super) fn arrays(network: &Network) -> Vec<Array> {
    let parameters = network.parameters();
    let set = parameters.feature_set;
    let normalisation = &parameters.normalisation;
    let is_constant = |feature: usize| normalisation.feature_std[feature] == 0.0;
    let mut arrays = Vec::new();
    let mut add = |name: String, shape: Vec<usize>, values: &[f32]| {
        arrays.push(Array { name, shape, values: values.to_vec() });
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
    arrays
}

/// The metadata of a model file, as JSON with sorted keys.
pub(super) fn metadata(file: &[u8]) -> Result<String, ModelError> {
    let (_, header) = SafeTensors::read_metadata(file)?;
    // Sorted, so the same model gives the same bytes.
    let fields: BTreeMap<_, _> = header.metadata().iter().flatten().collect();
    Ok(serde_json::json!(fields).to_string())
}
