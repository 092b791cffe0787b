//! Model files of NumPy and PyTorch are imported as the same model.

use std::fmt::Write as _;

use crate::fixture::{WHOLE, expected, fixture};
use joulebus_dataset::trial::Trial;
use joulebus_model_files::{
    ActivationFrom, CHECK_ROWS, Checkpoint, Choice, ChooseError, Container, Convention, Derivative,
    EntryValue, FindError, Found, LagOrder, Lags, Magnitude, Origin, PowerUnit, ReadError,
    StatisticsFrom, to_arrays, to_npz, to_onnx,
};
use joulebus_predictor::{Activation, FEATURES, FeatureSet, Features, Network};
use joulebus_testkit::{assert_contains, cases};
use joulebus_testkit_networks::random;

const STEP_S: f64 = 1.0 / 30.0;
/// The convention by which `tools/model_fixtures.py` computes its expected forecasts.
const FIXTURES: Convention = Convention {
    unit: PowerUnit::Milliwatt,
    order: LagOrder::Newest,
    lags: Lags::Last,
    derivative: Derivative::NormalisedPerSecond,
    magnitude: Magnitude::AsVelocity,
};
const ORIGIN: Origin<'_> = Origin { name: "fixture", file: "fixture.npy", sha256: "00" };

fn found(name: &str) -> Found {
    let file = Checkpoint::read(&fixture(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    file.find(None, None).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// GELU by the error function.
fn gelu(x: f64) -> f64 {
    0.5 * x * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

/// The network by plain loops, from normalised features in the file's order.
fn evaluated(found: &Found, mut values: Vec<f64>) -> f64 {
    for (number, found) in found.layers.iter().enumerate() {
        let rows = found.layer.weights.chunks(values.len());
        let sums = rows.zip(&found.layer.bias).map(|(row, bias)| {
            let products = row.iter().zip(&values).map(|(w, x)| f64::from(*w) * x);
            f64::from(*bias) + products.sum::<f64>()
        });
        values = sums.map(|sum| if number < 3 { gelu(sum) } else { sum }).collect();
    }
    values[0]
}

/// Statistics of the published model, as in the fixtures.
const V: (f64, f64) = (0.0279, 0.0736);
const OMEGA: (f64, f64) = (0.0479, 1.0187);
const POWER_W: (f64, f64) = (3.6517, 0.3747);

/// Inputs of a file under a convention, computed directly from its definition.
fn file_features(
    convention: &Convention,
    now: [f64; 2],
    before: [f64; 2],
    lag_w: &[f64],
) -> Vec<f64> {
    let [v, omega] = now;
    let normal = |x: f64, (mean, std): (f64, f64)| (x - mean) / std;
    let difference = |now: f64, before: f64, stat: (f64, f64)| match convention.derivative {
        Derivative::RawPerSecond => (now - before) / STEP_S,
        Derivative::RawPerStep => now - before,
        Derivative::NormalisedPerSecond => (normal(now, stat) - normal(before, stat)) / STEP_S,
        Derivative::NormalisedPerStep => normal(now, stat) - normal(before, stat),
        _ => panic!("the fixtures have no statistics of derivatives"),
    };
    let magnitude = |x: f64, stat: (f64, f64)| match convention.magnitude {
        Magnitude::Raw => x.abs(),
        Magnitude::Divided => x.abs() / stat.1,
        Magnitude::AsVelocity => normal(x.abs(), stat),
        Magnitude::OfNormalised => normal(x, stat).abs(),
        Magnitude::Own => panic!("the fixtures have no statistics of magnitudes"),
    };
    let commands = [
        normal(v, V),
        normal(omega, OMEGA),
        difference(v, before[0], V),
        difference(omega, before[1], OMEGA),
        magnitude(v, V),
        magnitude(omega, OMEGA),
    ];
    let mut lags: Vec<f64> = lag_w.iter().map(|power| normal(*power, POWER_W)).collect();
    if convention.order == LagOrder::Oldest {
        lags.reverse();
    }
    match convention.lags {
        Lags::Last => [&commands[..], &lags].concat(),
        Lags::First => [&lags[..], &commands].concat(),
    }
}

/// A trial whose robot draws the network's forecast under a convention plus a little noise;
/// `moving` or with a constant command.
fn recorded(found: &Found, convention: &Convention, rows: usize, moving: bool) -> Trial {
    let mut seed = 7_u64;
    let mut uniform = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f64 / f64::from(1 << 24) * 2.0 - 1.0
    };
    let mut csv = "robot_id,timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW\n".to_owned();
    let mut before = [0.0, 0.0];
    let mut lag_w = vec![3.6; 5];
    let mut command = [0.05, 0.1];
    for row in 0..rows {
        if moving && row % 3 == 0 {
            command = [0.2 * uniform(), 2.0 * uniform()];
        }
        let output = evaluated(found, file_features(convention, command, before, &lag_w));
        let power_w = output * POWER_W.1 + POWER_W.0 + 0.001 * uniform();
        let ([v, omega], time_s) = (command, row as f64 * STEP_S);
        let milliwatt = power_w * 1e3;
        writeln!(csv, "1,{time_s:.9},{v},{omega},{milliwatt}").unwrap();
        lag_w.insert(0, power_w);
        lag_w.truncate(5);
        before = command;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trial.csv");
    std::fs::write(&path, csv).unwrap();
    Trial::read(path).unwrap()
}

fn chosen(found: &Found, trial: &Trial, forced: Option<Convention>) -> Result<Choice, ChooseError> {
    found.choose(std::slice::from_ref(trial), forced, &ORIGIN)
}

#[test]
fn every_file_of_numpy_and_pytorch_gives_forecasts_within_1e5_w_of_theirs() {
    let inputs = expected("features");
    let (by_numpy, by_torch) = (expected("numpy_power_w"), expected("torch_power_w"));
    let rows: Vec<Features> = inputs
        .chunks(FEATURES)
        .map(|row| std::array::from_fn(|feature| row.get(feature).map_or(f32::NAN, |x| *x as f32)))
        .collect();
    for name in WHOLE {
        let found = found(name);
        let trial = recorded(&found, &FIXTURES, 150, true);
        let choice = chosen(&found, &trial, Some(FIXTURES)).unwrap();
        let mut forecasts_w = vec![0.0; rows.len()];
        choice.network().predict(&rows, &mut forecasts_w);
        for ((forecast, numpy), torch) in forecasts_w.iter().zip(&by_numpy).zip(&by_torch) {
            let (a, b) = (f64::from(*forecast) - numpy, f64::from(*forecast) - torch);
            assert!(a.abs() < 1e-5 && b.abs() < 1e-5, "{name}: {a:e} {b:e}");
        }
    }
}

#[test]
fn arrays_are_found_by_shape_and_statistics_by_name_in_every_style() {
    // Whether matrices are transposed, layers paired by name, and statistics documented.
    for case in cases(
        "
        flat.npy | by name | W2 | b2
        nested.npy | transposed | weights.matrices.1 | weights.biases.1
        pairs.npy | documented | 2 | 3
        lists.npy | by name | layers.1.w | layers.1.b
        arrays.npz | by name | layers.1.weight | layers.1.bias
        state_dict.pt | by name, documented | 3.weight | 3.bias
        state_dict_legacy.pt | by name, documented | 3.weight | 3.bias
        checkpoint.pt | by name | model_state_dict.net.3.weight | model_state_dict.net.3.bias
        module.pt | by name, documented | 3.weight | 3.bias
        ",
    ) {
        let [name, how, weight, bias] = case.as_slice() else {
            panic!("{case:?}");
        };
        let [transposed, by_name, documented] =
            ["transposed", "by name", "documented"].map(|part| how.contains(part));
        let found = found(name);
        assert_eq!(found.feature_set, FeatureSet::Full, "{name}");
        assert_eq!(found.transposed, transposed, "{name}");
        assert_eq!(found.paired_by_name, by_name, "{name}");
        let is_assumed = found.normalisation.from == StatisticsFrom::Assumed;
        assert_eq!(is_assumed, documented, "{name}");
        assert_eq!(&found.layers[1].weight_path, weight, "{name}");
        assert_eq!(&found.layers[1].bias_path, bias, "{name}");
        assert_eq!(found.layers, relabelled(&found, "flat.npy"), "{name}");
    }
}

/// The layers of another file, matched by the names in this one.
fn relabelled(found: &Found, other: &str) -> Vec<joulebus_model_files::FoundLayer> {
    let mut layers = self::found(other).layers;
    for (layer, own) in layers.iter_mut().zip(&found.layers) {
        layer.weight_path.clone_from(&own.weight_path);
        layer.bias_path.clone_from(&own.bias_path);
    }
    layers
}

#[test]
fn the_convention_that_made_the_data_is_found_with_a_clear_margin() {
    let found = found("flat.npy");
    let changes: [fn(&mut Convention); 6] = [
        |_| (),
        |convention| convention.order = LagOrder::Oldest,
        |convention| convention.lags = Lags::First,
        |convention| convention.derivative = Derivative::NormalisedPerStep,
        |convention| {
            (convention.derivative, convention.magnitude) =
                (Derivative::RawPerSecond, Magnitude::Raw);
        },
        |convention| {
            (convention.derivative, convention.magnitude) =
                (Derivative::RawPerStep, Magnitude::Divided);
        },
    ];
    for change in changes {
        let mut convention = FIXTURES;
        change(&mut convention);
        let trial = recorded(&found, &convention, 1_500, true);
        let choice = chosen(&found, &trial, None).unwrap();
        let (best, next) = (choice.ranking[0], choice.ranking[1]);
        let ranking = format!("{convention}: {best:?} before {next:?}");
        assert_eq!(choice.convention, convention, "{ranking}");
        assert!(best.r2 > 0.99, "{ranking}");
        assert_eq!(choice.blocks_won, choice.blocks, "{ranking}");
        assert!(choice.margin_r2 >= best.r2 - next.r2, "{ranking}");
        let name = convention.to_string();
        assert_eq!(name.parse::<Convention>().unwrap(), convention);
        let card = choice.network().card();
        assert_contains(&card.source, [&name]);
        assert_eq!(card.scores.rows, choice.rows as u64);
    }
}

#[test]
fn a_convention_that_the_worker_cannot_compute_is_named_and_not_imported() {
    let found = found("flat.npy");
    let convention = Convention { magnitude: Magnitude::OfNormalised, ..FIXTURES };
    let trial = recorded(&found, &convention, 1_500, true);
    match chosen(&found, &trial, None) {
        Err(ChooseError::CannotRun { convention: named, r2, runner_up, .. }) => {
            assert_eq!(named, convention);
            assert!(r2 > 0.99);
            assert!(chosen(&found, &trial, Some(runner_up)).is_ok());
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn data_that_cannot_distinguish_conventions_give_no_clear_choice() {
    let found = found("flat.npy");
    let trial = recorded(&found, &FIXTURES, 600, false);
    match chosen(&found, &trial, None) {
        Ok(choice) => panic!("{:?}", choice.ranking),
        Err(ChooseError::NothingFits { .. } | ChooseError::Indistinguishable { .. }) => {}
        Err(error) => panic!("{error}"),
    }
}

/// A network that also reads the age of the newest reading.
fn fresh() -> Network {
    random::network(1, FeatureSet::Freshness)
}

#[test]
fn a_joulebus_model_exported_as_arrays_is_read_with_the_same_hash_and_bytes() {
    let found = found("checkpoint.pt");
    let trial = recorded(&found, &FIXTURES, 600, true);
    let choice = chosen(&found, &trial, Some(FIXTURES)).unwrap();
    for network in [choice.network(), &fresh(), &with_constant_features()] {
        survives_export(network);
    }
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

#[test]
fn exported_arrays_divide_by_no_zero_and_ignore_what_the_network_ignores() {
    let network = with_constant_features();
    let arrays = Checkpoint::from_arrays(&to_arrays(&network).unwrap()).unwrap();
    let array = |name: &str| {
        let entry = arrays.entries.iter().find(|entry| entry.path == name);
        match entry.map(|entry| &entry.value) {
            Some(EntryValue::Tensor(tensor)) => tensor.values().to_vec(),
            other => panic!("{name}: {other:?}"),
        }
    };
    let (mean, std) = (array("feature_mean"), array("feature_std"));
    assert_eq!((std[1], std[3]), (1.0, 1.0));
    // A row in which the constant features changed after all.
    let row: Features = std::array::from_fn(|feature| 0.1 * feature as f32 + 0.3);
    let mut values: Vec<f64> = (0..FEATURES)
        .map(|feature| (f64::from(row[feature]) - mean[feature]) / std[feature])
        .collect();
    for layer in 0..4 {
        let weights = array(&format!("layers.{layer}.weight"));
        let bias = array(&format!("layers.{layer}.bias"));
        let sums = weights
            .chunks(values.len())
            .zip(bias)
            .map(|(row, bias)| bias + row.iter().zip(&values).map(|(w, x)| w * x).sum::<f64>());
        values = sums.map(|sum| if layer < 3 { gelu(sum) } else { sum }).collect();
    }
    let power_w = values[0] * array("power_std_w")[0] + array("power_mean_w")[0];
    let own = network.predict_reference_f64(&row);
    assert!((power_w - own).abs() < 1e-9, "{power_w} {own}");
}

fn survives_export(network: &Network) {
    let archive = to_npz(network).unwrap();
    assert_eq!(archive, to_npz(network).unwrap());
    let own = network.to_safetensors().unwrap();
    let (onnx, arrays) = (to_onnx(network).unwrap(), to_arrays(network).unwrap());
    for (container, read) in [
        (Container::Safetensors, Checkpoint::read(&own)),
        (Container::Npz, Checkpoint::read(&archive)),
        (Container::Onnx, Checkpoint::read(&onnx)),
        (Container::Arrays, Checkpoint::from_arrays(&arrays)),
    ] {
        let read = read.unwrap();
        assert_eq!(read.container, container);
        let again = read.network.expect("a joulebus model");
        assert_eq!(again.hash(), network.hash());
        assert_eq!(again.to_safetensors().unwrap(), own);
    }
    let read = Checkpoint::read(&archive).unwrap();
    let array = |name: &str| {
        let entry = read.entries.iter().find(|entry| entry.path == name);
        match &entry.unwrap().value {
            EntryValue::Tensor(tensor) => tensor.values().to_vec(),
            _ => panic!("{name}"),
        }
    };
    let (rows, inputs) = (array("check_features"), network.feature_set().inputs());
    assert_eq!(rows.len(), CHECK_ROWS * inputs);
    for (row, forecast_w) in rows.chunks(inputs).zip(array("check_power_w")) {
        let value = |feature: usize| row.get(feature).map_or(f32::NAN, |value| *value as f32);
        let row: Features = std::array::from_fn(value);
        let slow = network.predict_reference_f64(&row);
        assert!((slow - forecast_w).abs() < 1e-5, "{slow} {forecast_w}");
    }
}

#[test]
fn a_network_of_another_program_is_not_assumed_to_read_the_reading_age() {
    let mut arrays = to_arrays(&fresh()).unwrap();
    arrays.retain(|(name, _)| name != "metadata");
    let read = Checkpoint::from_arrays(&arrays).unwrap();
    assert!(read.network.is_none());
    let error = read.find(None, None).unwrap_err().to_string();
    assert_contains(&error, ["is read only from a file of joulebus", "64, 13"]);
}

#[test]
fn an_exported_array_that_contradicts_the_metadata_is_refused_by_name() {
    let network = shipped();
    for changed in ["layers.2.bias", "feature_mean", "power_std_w"] {
        let mut arrays = to_arrays(&network).unwrap();
        let (_, bytes) = arrays.iter_mut().find(|(name, _)| name == changed).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        let damaged = arrays.clone();
        arrays.retain(|(name, _)| name != changed);
        for arrays in [damaged, arrays] {
            let error = Checkpoint::from_arrays(&arrays).unwrap_err().to_string();
            let is_named = error.contains(changed) || error.contains("SHA-256");
            assert!(is_named, "{changed}: {error}");
        }
    }
}

fn shipped() -> Network {
    let path =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/models/gternal-sim.safetensors");
    Network::from_safetensors(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn the_activation_is_taken_from_the_layers_and_a_program_is_refused() {
    let mut mixed = Checkpoint::read(&fixture("module_tanh.pt")).unwrap();
    let found = mixed.find(None, None).unwrap();
    let stated = |found: &Found| (found.activation, found.activation_from);
    let by_file = |activation| (activation, ActivationFrom::File);
    assert_eq!(stated(&found), by_file(Activation::GeluTanh));
    let erf = self::found("module.pt");
    assert_eq!(stated(&erf), by_file(Activation::GeluErf));
    let plain = self::found("state_dict.pt");
    assert_eq!(plain.activation_from, ActivationFrom::Default);
    let entries = mixed.entries.iter_mut();
    let mut settings = entries.filter(|entry| entry.path.ends_with("approximate"));
    settings.next_back().unwrap().value = EntryValue::Text("none".to_owned());
    let error = mixed.find(None, None).unwrap_err();
    let differ = matches!(&error, FindError::ActivationsDiffer { .. });
    assert!(differ, "{error}");
    let error = Checkpoint::read(&fixture("script.pt")).unwrap_err();
    assert!(error.to_string().contains("TorchScript"), "{error}");
}

#[test]
fn files_of_other_formats_are_refused_with_what_was_found() {
    for (bytes, expected_text) in [
        (&b""[..], "empty"),
        (b"robot_id,timestamp_s\n", "72, 6f"),
        (b"\x89HDF\r\n\x1a\n", "found an HDF5 file"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (b"\x93NUMPY\x01\x00", "header"),
    ] {
        let error = Checkpoint::read(bytes).unwrap_err().to_string();
        assert!(error.contains(expected_text), "{error}");
    }
    let error = Checkpoint::read(&vec![0; (16 << 20) + 1]).unwrap_err();
    let found = matches!(error, ReadError::TooLarge { found: 16_777_217 });
    assert!(found, "{error}");
}
