//! Exported models have the numbers and the forecasts of the model.

use joulebus_model_files::{CHECK_ROWS, to_arrays, to_npz, to_onnx};
use joulebus_predictor::{Activation, FEATURES, FeatureSet, Features, Network};
use joulebus_testkit_fleets::{exact, random};

fn shipped() -> Network {
    let path =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/models/gternal-sim.safetensors");
    Network::from_safetensors(&std::fs::read(path).unwrap()).unwrap()
}

/// A network two of whose features were constant in training; its weights for them are not zero.
fn with_constant_features() -> Network {
    let shipped = shipped();
    let mut parameters = shipped.parameters().clone();
    let mut card = shipped.card().clone();
    for feature in [1, 3] {
        parameters.normalisation.feature_std[feature] = 0.0;
        let mean = parameters.normalisation.feature_mean[feature];
        card.training_range.min[feature] = mean;
        card.training_range.max[feature] = mean;
    }
    parameters.layers[0].weights[1] = -0.0;
    Network::new(parameters, card).unwrap()
}

/// The numbers of an exported array, which are singles.
fn numbers(arrays: &[(String, Vec<u8>)], name: &str) -> Vec<f64> {
    let found = arrays.iter().find(|(known, _)| known == name);
    let (_, bytes) = found.unwrap_or_else(|| panic!("{name}"));
    let end = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let (words, _) = bytes[end..].as_chunks::<4>();
    words.iter().map(|word| f64::from(f32::from_le_bytes(*word))).collect()
}

#[test]
fn every_export_is_the_same_bytes_again_and_has_rows_with_their_forecasts() {
    for network in [random::network(1, FeatureSet::Freshness), with_constant_features(), shipped()]
    {
        let arrays = to_arrays(&network).unwrap();
        assert_eq!(arrays, to_arrays(&network).unwrap());
        assert_eq!(to_npz(&network).unwrap(), to_npz(&network).unwrap());
        assert_eq!(to_onnx(&network).unwrap(), to_onnx(&network).unwrap());
        let (rows, inputs) = (numbers(&arrays, "check_features"), network.feature_set().inputs());
        assert_eq!(rows.len(), CHECK_ROWS * inputs);
        for (row, forecast_w) in rows.chunks(inputs).zip(numbers(&arrays, "check_power_w")) {
            let value = |feature: usize| row.get(feature).map_or(f32::NAN, |value| *value as f32);
            let row: Features = std::array::from_fn(value);
            let slow = exact::forecast_w(&network, &row);
            assert!((slow - forecast_w).abs() < 1e-5, "{slow} {forecast_w}");
        }
    }
}

#[test]
fn exported_arrays_divide_by_no_zero_and_ignore_what_the_network_ignores() {
    let network = with_constant_features();
    let arrays = to_arrays(&network).unwrap();
    let array = |name: &str| numbers(&arrays, name);
    let (mean, std) = (array("feature_mean"), array("feature_std"));
    assert_eq!((std[1], std[3]), (1.0, 1.0));
    // A row in which the constant features changed after all.
    let row: Features = std::array::from_fn(|feature| 0.1 * feature as f32 + 0.3);
    let inputs = (0..FEATURES)
        .map(|feature| (f64::from(row[feature]) - mean[feature]) / std[feature])
        .collect();
    let single = |name: String| array(&name).into_iter().map(|value| value as f32).collect();
    let layers = [0, 1, 2, 3].map(|layer| {
        (single(format!("layers.{layer}.weight")), single(format!("layers.{layer}.bias")))
    });
    let output = exact::Layers::new(&layers, Activation::GeluErf).output(inputs);
    let power_w = output * array("power_std_w")[0] + array("power_mean_w")[0];
    let own = exact::forecast_w(&network, &row);
    assert!((power_w - own).abs() < 1e-9, "{power_w} {own}");
}
