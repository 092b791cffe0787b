//! Networks of other sizes, activations, element types and containers than the published one: run
//! with the same result, or refused with numbers. And conventions: by the file's own statistics
//! first, and never by chance.

use std::collections::HashMap;
use std::fmt::Write as _;

use joulebus_dataset::trial::Trial;
use joulebus_model_files::{
    ActivationFrom, Checkpoint, Choice, ChooseError, Container, Convention, FindError, Found,
    Origin, StatisticsFrom,
};
use joulebus_predictor::{Activation, FEATURES, Features, Network};
use joulebus_testkit::assert_contains;
use joulebus_testkit_networks::random::Noise;
use safetensors::tensor::{Dtype, TensorView};

const ORIGIN: Origin<'_> = Origin { name: "fixture", file: "fixture.safetensors", sha256: "00" };
const CONVENTION: &str = "W+newest-first+lags-last+d-own-per-second+abs-own";
/// Statistics of the eleven features of a robot of some 49 W, per second.
const MEAN: [f64; 11] = [0.3, 0.1, 0.01, 0.0, 0.35, 0.4, 49.0, 49.0, 49.0, 49.0, 49.0];
const STD: [f64; 11] = [0.2, 0.5, 0.5, 1.2, 0.15, 0.3, 6.0, 6.0, 6.0, 6.0, 6.0];
const POWER: (f64, f64) = (49.0, 6.0);

/// Layers of these widths, inputs first: weights one row per output, and biases.
type Layers = Vec<(Vec<f32>, Vec<f32>)>;

fn layers(widths: &[usize], seed: u64) -> Layers {
    let mut noise = Noise(seed);
    let pairs = widths.windows(2).map(|pair| {
        let scale = 1.5 / (pair[0] as f32).sqrt();
        let weights = (0..pair[0] * pair[1]).map(|_| noise.next_f32() * scale);
        let weights: Vec<f32> = weights.collect();
        let bias = (0..pair[1]).map(|_| noise.next_f32() * 0.3).collect();
        (weights, bias)
    });
    pairs.collect()
}

/// A state dict as `safetensors.torch.save_file` writes it.
fn state_dict(layers: &Layers, dtype: Dtype, metadata: &[(&str, &str)]) -> Vec<u8> {
    let encode = |values: &[f32]| -> Vec<u8> {
        let bytes = values.iter().map(|value| match dtype {
            Dtype::BF16 => value.to_le_bytes()[2..].to_vec(),
            Dtype::F16 => half(*value).to_le_bytes().to_vec(),
            Dtype::F64 => f64::from(*value).to_le_bytes().to_vec(),
            _ => value.to_le_bytes().to_vec(),
        });
        bytes.flatten().collect()
    };
    let mut tensors = Vec::new();
    for (number, (weights, bias)) in layers.iter().enumerate() {
        let inputs = weights.len() / bias.len();
        // Numbered as in a Sequential with an activation after each: 10 comes before 3 by letters.
        let name = |what: &str| format!("net.{}.{what}", number * 5);
        tensors.push((name("weight"), vec![bias.len(), inputs], encode(weights)));
        tensors.push((name("bias"), vec![bias.len()], encode(bias)));
    }
    serialized(&tensors, dtype, metadata)
}

/// Tensors of these names, shapes and bytes as a file.
fn serialized(
    tensors: &[(String, Vec<usize>, Vec<u8>)],
    dtype: Dtype,
    metadata: &[(&str, &str)],
) -> Vec<u8> {
    let views = tensors.iter().map(|(name, shape, bytes)| {
        let view = TensorView::new(dtype, shape.clone(), bytes).unwrap();
        (name.as_str(), view)
    });
    let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
    let metadata: HashMap<String, String> = metadata.iter().map(owned).collect();
    safetensors::serialize(views, Some(metadata)).unwrap()
}

/// The half nearest to a number that a half can hold: the tests' numbers are rounded first.
fn half(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16 & 0x8000) as u16;
    let exponent = (bits >> 23 & 0xff) as i32 - 112;
    if exponent <= 0 {
        return sign;
    }
    sign | (exponent as u16) << 10 | (bits >> 13 & 0x3ff) as u16
}

/// Statistics of the features as metadata.
fn statistics() -> [(&'static str, String); 4] {
    [
        ("feature_mean", format!("{MEAN:?}")),
        ("feature_std", format!("{STD:?}")),
        ("power_mean", POWER.0.to_string()),
        ("power_std", POWER.1.to_string()),
    ]
}

fn read(layers: &Layers, dtype: Dtype, activation: Option<&str>) -> Checkpoint {
    let statistics = statistics();
    let mut metadata = vec![("format", "pt")];
    metadata.extend(statistics.iter().map(|(key, value)| (*key, value.as_str())));
    metadata.extend(activation.map(|activation| ("activation", activation)));
    Checkpoint::read(&state_dict(layers, dtype, &metadata)).unwrap()
}

fn value(activation: Activation, x: f64) -> f64 {
    match activation {
        Activation::GeluErf => 0.5 * x * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2),
        Activation::GeluTanh => {
            let scale = (2.0 / std::f64::consts::PI).sqrt();
            0.5 * x * (1.0 + libm::tanh(scale * (x + 0.044715 * x * x * x)))
        }
        Activation::Relu => x.max(0.0),
    }
}

/// The unpadded network in double precision, from features in SI units.
fn unpadded(layers: &Layers, activation: Activation, row: &Features) -> f64 {
    let mut values: Vec<f64> = (0..FEATURES)
        .map(|feature| {
            let (mean, std) = (MEAN[feature] as f32, STD[feature] as f32);
            (f64::from(row[feature]) - f64::from(mean)) / f64::from(std)
        })
        .collect();
    for (number, (weights, bias)) in layers.iter().enumerate() {
        let rows = weights.chunks(values.len()).zip(bias);
        let sums = rows.map(|(row, bias)| {
            let products = row.iter().zip(&values).map(|(w, x)| f64::from(*w) * x);
            f64::from(*bias) + products.sum::<f64>()
        });
        values = sums
            .map(|sum| match number + 1 == layers.len() {
                true => sum,
                false => value(activation, sum),
            })
            .collect();
    }
    values[0] * POWER.1 + POWER.0
}

fn row(noise: &mut Noise) -> Features {
    std::array::from_fn(|feature| match feature < FEATURES {
        true => (MEAN[feature] + STD[feature] * 2.0 * f64::from(noise.next_f32())) as f32,
        false => f32::NAN,
    })
}

/// A trial of a robot of some 49 W. Its power is `power_w` of the features of each row, per second,
/// and a little noise.
fn recorded(rows: usize, noise_w: f64, mut power_w: impl FnMut(&Features) -> f64) -> Trial {
    let mut noise = Noise(5);
    let mut csv = "robot_id,timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW\n".to_owned();
    let (mut v, mut omega, mut before) = (0.0_f32, 0.0_f32, (0.0_f32, 0.0_f32));
    let mut lag_w = [49.0_f32; 5];
    for at in 0..rows {
        // Steps of a few hundredths: as large in m/s² as in the statistics.
        v = (v + 0.025 * noise.next_f32()).clamp(-0.3, 0.7);
        omega = (omega + 0.06 * noise.next_f32()).clamp(-1.0, 1.0);
        let previous = Some((before.0, before.1, 1.0 / 30.0));
        let features = joulebus_predictor::features(v, omega, previous, &lag_w);
        let power = (power_w(&features) + noise_w * f64::from(noise.next_f32())) as f32;
        let milliwatt = f64::from(power) * 1e3;
        writeln!(csv, "1,{:.9},{v},{omega},{milliwatt}", at as f64 / 30.0).unwrap();
        before = (v, omega);
        lag_w.copy_within(0..4, 1);
        lag_w[0] = power;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trial.csv");
    std::fs::write(&path, csv).unwrap();
    Trial::read(path).unwrap()
}

/// A trial with some motion and power, where only the format matters.
fn any_trial() -> Trial {
    recorded(200, 0.3, |features| {
        40.0 + 0.18 * f64::from(features[6]) + 4.0 * f64::from(features[0])
    })
}

fn chosen(found: &Found, trial: &Trial, forced: Option<&str>) -> Result<Choice, ChooseError> {
    let forced = forced.map(|convention| convention.parse::<Convention>().unwrap());
    found.choose(std::slice::from_ref(trial), forced, &ORIGIN)
}

fn imported(checkpoint: &Checkpoint, trial: &Trial) -> Network {
    let found = checkpoint.find(None, None).unwrap();
    let choice = chosen(&found, trial, Some(CONVENTION)).unwrap();
    choice.network().clone()
}

/// Largest difference between the padded network and the unpadded one, in units of the output
/// scale: by the reference in double precision, and by the kernel.
fn difference(network: &Network, layers: &Layers, activation: Activation) -> (f64, f64) {
    let mut noise = Noise(11);
    let (mut reference, mut kernel) = (0.0_f64, 0.0_f64);
    for _ in 0..50 {
        let row = row(&mut noise);
        let expected = unpadded(layers, activation, &row);
        let mut forecast_w = [0.0];
        network.predict(&[row], &mut forecast_w);
        let slow = network.predict_reference_f64(&row);
        reference = reference.max((slow - expected).abs() / POWER.1);
        kernel = kernel.max((f64::from(forecast_w[0]) - expected).abs() / POWER.1);
    }
    (reference, kernel)
}

#[test]
fn a_smaller_network_of_any_depth_and_activation_gives_the_unpadded_result() {
    let trial = any_trial();
    for hidden in "64 64 32|1 1 1|32 32 32|16 64 5|11 11 11|64 64|24 24|3 64|64|7|1".split('|') {
        let hidden: Vec<usize> = hidden.split(' ').map(|width| width.parse().unwrap()).collect();
        let widths: Vec<usize> = [&[FEATURES][..], &hidden, &[1]].concat();
        for activation in Activation::ALL {
            let layers = layers(&widths, 3);
            let checkpoint = read(&layers, Dtype::F32, Some(activation.name()));
            assert_eq!(checkpoint.container, Container::StateDict);
            let found = checkpoint.find(None, None);
            let found = found.unwrap_or_else(|e| panic!("{widths:?}: {e}"));
            assert_eq!(found.layers.len(), widths.len() - 1, "{widths:?}");
            assert_eq!(found.activation, activation);
            let network = imported(&checkpoint, &trial);
            let (reference, kernel) = difference(&network, &layers, activation);
            // A float of 49 W has a unit of 4e-6 in the last place.
            let what = format!("{widths:?} {activation:?}: {reference:e} {kernel:e}");
            assert!(reference < 1e-12 && kernel < 6e-6, "{what}");
        }
    }
}

#[test]
fn a_larger_network_is_refused_with_its_widths_and_the_allowed_ones() {
    for (widths, shown) in [
        (&[11, 128, 64, 32, 1][..], "11→128→64→32→1"),
        (&[11, 64, 64, 64, 1], "11→64→64→64→1"),
        (&[11, 65, 1], "11→65→1"),
        (&[11, 32, 32, 32, 32, 1], "11→32→32→32→32→1"),
        (&[9, 64, 64, 32, 1], "9→64→64→32→1"),
    ] {
        let checkpoint = read(&layers(widths, 3), Dtype::F32, None);
        let error = checkpoint.find(None, None).unwrap_err().to_string();
        assert_contains(&error, [shown, "64, 64 and 32"]);
    }
}

#[test]
fn an_array_that_may_belong_to_a_layer_is_not_left_out() {
    let widths = [11, 24, 16, 1];
    let plain = layers(&widths, 3);
    let mut tensors = Vec::new();
    for (number, (weights, bias)) in plain.iter().enumerate() {
        let bytes =
            |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
        let shape = vec![bias.len(), weights.len() / bias.len()];
        tensors.push((format!("net.{number}.weight"), shape, bytes(weights)));
        tensors.push((format!("net.{number}.bias"), vec![bias.len()], bytes(bias)));
    }
    // A normalisation layer: vectors of the first layer's width.
    for what in ["weight", "bias"] {
        tensors.push((format!("norm.{what}"), vec![24], vec![0; 96]));
    }
    let read = Checkpoint::read(&serialized(&tensors, Dtype::F32, &[])).unwrap();
    let error = read.find(None, None).unwrap_err();
    let is_named = matches!(&error, FindError::NormalisationLayer { .. });
    assert!(is_named, "{error}");
    assert!(error.to_string().contains("norm."), "{error}");

    // Weights as a product of direction and length.
    tensors.truncate(2 * plain.len());
    "net.0.parametrizations.weight.original1".clone_into(&mut tensors[0].0);
    tensors.push(("net.0.parametrizations.weight.original0".to_owned(), vec![24, 1], vec![0; 96]));
    let read = Checkpoint::read(&serialized(&tensors, Dtype::F32, &[])).unwrap();
    let error = read.find(None, None).unwrap_err().to_string();
    assert_contains(&error, ["net.0.parametrizations", "weight_norm", "remove_parametrizations"]);
}

#[test]
fn halves_and_doubles_are_read_as_the_numbers_that_they_are() {
    let trial = any_trial();
    for dtype in [Dtype::F16, Dtype::BF16, Dtype::F64] {
        let mut layers = layers(&[11, 48, 20, 1], 4);
        // Numbers that each of the types holds exactly.
        let both = layers.iter_mut().flat_map(|(weights, bias)| [weights, bias]);
        for value in both.flatten() {
            *value = (*value * 64.0).round() / 64.0;
        }
        let network = imported(&read(&layers, dtype, Some("relu")), &trial);
        let (reference, _) = difference(&network, &layers, Activation::Relu);
        assert!(reference < 1e-12, "{dtype:?}: {reference:e}");
    }
}

#[test]
fn an_activation_that_the_kernel_lacks_is_refused_until_the_caller_names_another() {
    for stated in ["tanh", "sigmoid", "leaky_relu"] {
        let checkpoint = read(&layers(&[11, 64, 64, 32, 1], 3), Dtype::F32, Some(stated));
        let error = checkpoint.find(None, None).unwrap_err();
        assert!(matches!(&error, FindError::Activation { .. }), "{error}");
        let text = error.to_string();
        assert_contains(&text, [stated, "gelu_erf, gelu_tanh, relu"]);
        let found = checkpoint.find(None, Some(Activation::Relu)).unwrap();
        assert_eq!(found.activation, Activation::Relu);
        assert_eq!(found.activation_from, ActivationFrom::Caller);
    }
}

#[test]
fn the_files_own_statistics_rule_conventions_out_before_recordings_decide() {
    // A network that hardly reads the derivatives: recordings alone cannot distinguish per step
    // from per second. The statistics are per second.
    let mut layers = layers(&[11, 64, 64, 32, 1], 6);
    for row in layers[0].0.chunks_mut(FEATURES) {
        row[2] *= 1e-3;
        row[3] *= 1e-3;
        // The newest reading counts most, so that the order of the readings is identifiable.
        row[6] *= 4.0;
        row[7..].iter_mut().for_each(|weight| *weight *= 0.1);
    }
    let last = layers.last_mut().unwrap();
    last.0.iter_mut().for_each(|weight| *weight *= 0.5);
    let trial = recorded(3_000, 0.02, |features| unpadded(&layers, Activation::Relu, features));
    let found = read(&layers, Dtype::F32, Some("relu")).find(None, None).unwrap();
    assert_eq!(found.normalisation.from, StatisticsFrom::File);
    let choice = chosen(&found, &trial, None).unwrap();
    assert_eq!(choice.convention.to_string(), CONVENTION);
    let is_per_step = |convention: &Convention| convention.to_string().contains("per-step");
    let (out, mut ranking) = (&choice.ruled_out, choice.ranking.iter());
    assert!(out.iter().any(is_per_step), "{out:?}");
    assert!(!ranking.any(|ranked| is_per_step(&ranked.convention)));
    let milliwatt = |convention: &Convention| convention.to_string().starts_with("mW");
    assert!(out.iter().any(milliwatt));
}

#[test]
fn conventions_that_forecast_alike_are_named_and_none_is_chosen() {
    // All readings weigh the same, so their order is not identifiable.
    let mut layers = layers(&[11, 32, 1], 6);
    for row in layers[0].0.chunks_mut(FEATURES) {
        let mean = row[6..].iter().sum::<f32>() / 5.0;
        for (lag, weight) in row[6..].iter_mut().enumerate() {
            *weight = mean * (1.0 + 0.001 * lag as f32);
        }
    }
    layers.last_mut().unwrap().0.iter_mut().for_each(|weight| *weight *= 0.4);
    let trial = recorded(3_000, 0.3, |features| unpadded(&layers, Activation::GeluErf, features));
    let found = read(&layers, Dtype::F32, None).find(None, None).unwrap();
    let error = chosen(&found, &trial, None).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, ChooseError::Indistinguishable { .. }), "{text}");
    assert_contains(&text, ["newest-first", "oldest-first", "--convention"]);
    assert!(chosen(&found, &trial, Some(CONVENTION)).is_ok());
}

#[test]
fn constants_of_the_published_robot_are_not_taken_for_a_larger_one() {
    let layers = layers(&[11, 64, 64, 32, 1], 8);
    let trial = any_trial();
    let bytes = state_dict(&layers, Dtype::F32, &[("format", "pt")]);
    let mut found = Checkpoint::read(&bytes).unwrap().find(None, None).unwrap();
    assert_eq!(found.normalisation.from, StatisticsFrom::Assumed);
    let error = chosen(&found, &trial, None).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, ChooseError::NotPublished { .. }), "{text}");
    assert_contains(&text, ["3.652", "--normalisation recordings"]);
    // With the recordings' own constants, the output scale is theirs.
    found.normalisation.from = StatisticsFrom::Recordings;
    let choice = chosen(&found, &trial, Some(CONVENTION)).unwrap();
    let normalisation = choice.network().parameters().normalisation;
    assert!((40.0..60.0).contains(&normalisation.power_mean_w), "{normalisation:?}");
    assert!(normalisation.feature_std[..FEATURES].iter().all(|std| *std > 0.0));
}
