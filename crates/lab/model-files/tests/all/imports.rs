//! Networks of other sizes and activations than the published one: run with the same result, or
//! refused with numbers.

use std::fmt::Write as _;

use joulebus_dataset::trial::Trial;
use joulebus_model_files::{ImportError, Plain};
use joulebus_predictor::{Activation, FEATURES, FeatureSet, Features, LAGS, Network};
use joulebus_testkit::assert_contains;
use joulebus_testkit_fleets::exact;
use joulebus_testkit_fleets::random::Noise;
use safetensors::tensor::Dtype;

use crate::plain::{Contents, Layers, layers, trial};

/// Statistics of the eleven features of a robot of some 49 W, per second.
const MEAN: [f64; 11] = [0.3, 0.1, 0.01, 0.0, 0.35, 0.4, 49.0, 49.0, 49.0, 49.0, 49.0];
const STD: [f64; 11] = [0.2, 0.5, 0.5, 1.2, 0.15, 0.3, 6.0, 6.0, 6.0, 6.0, 6.0];
const POWER: (f64, f64) = (49.0, 6.0);

/// A network of these inputs, the last of the eleven, in watt and per second.
fn contents(layers: &Layers, activation: Activation, inputs: usize) -> Contents {
    let inputs: Vec<(f64, f64)> = MEAN.into_iter().zip(STD).skip(FEATURES - inputs).collect();
    let stated = [
        ("unit", "W"),
        ("lag_order", "newest-first"),
        ("activation", activation.name()),
        ("lags", "last"),
        ("derivative", "own-per-second"),
        ("magnitude", "own"),
    ];
    Contents::new(layers, &inputs, POWER, &stated)
}

/// The unpadded network in double precision, from features in SI units.
fn unpadded(layers: &Layers, activation: Activation, row: &Features) -> f64 {
    let inputs = layers[0].0.len() / layers[0].1.len();
    let values = (FEATURES - inputs..FEATURES).map(|feature| {
        let (mean, std) = (MEAN[feature] as f32, STD[feature] as f32);
        (f64::from(row[feature]) - f64::from(mean)) / f64::from(std)
    });
    exact::Layers::new(layers, activation).output(values.collect()) * POWER.1 + POWER.0
}

fn row(noise: &mut Noise) -> Features {
    std::array::from_fn(|feature| match feature < FEATURES {
        true => (MEAN[feature] + STD[feature] * 2.0 * f64::from(noise.next_f32())) as f32,
        false => f32::NAN,
    })
}

/// A trial of a robot of some 49 W that draws what the network forecasts, and a little noise.
fn recorded(rows: usize, noise_w: f64, power_w: impl Fn(&Features) -> f64) -> Trial {
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
    trial(&csv)
}

/// A network whose output varies, its contents, and the model that becomes of it. Small networks
/// with `relu` may be constant, which is refused.
fn varying(widths: &[usize], activation: Activation, dtype: Dtype) -> (Layers, Network) {
    for seed in 3..300 {
        let layers = layers(widths, seed);
        let mut contents = contents(&layers, activation, widths[0]);
        contents.dtype = dtype;
        let trial = recorded(300, 0.001, |features| unpadded(&layers, activation, features));
        let plain = Plain::read(&contents.bytes()).unwrap();
        match plain.import(&[trial], "lab", "x.safetensors") {
            Ok(imported) => return (layers, imported.network),
            Err(ImportError::NothingFits { .. }) => {}
            Err(error) => panic!("{widths:?} {activation:?}: {error}"),
        }
    }
    panic!("{widths:?} {activation:?}: all are constant")
}

#[test]
fn a_smaller_network_of_any_depth_and_activation_gives_the_unpadded_result() {
    let all = "64 64 32|1 1 1|32 32 32|16 64 5|11 11 11|64 64|24 24|3 64|64|7|1";
    for (number, hidden) in all.split('|').enumerate() {
        let hidden: Vec<usize> = hidden.split(' ').map(|width| width.parse().unwrap()).collect();
        for activation in Activation::ALL {
            // One in three reads the powers alone.
            let inputs =
                if (number + activation as usize).is_multiple_of(3) { LAGS } else { FEATURES };
            let widths: Vec<usize> = [&[inputs][..], &hidden, &[1]].concat();
            let dtype = if number % 2 == 0 { Dtype::F32 } else { Dtype::F64 };
            let (layers, network) = varying(&widths, activation, dtype);
            let reads = if inputs == LAGS { FeatureSet::PowerOnly } else { FeatureSet::Full };
            assert_eq!(network.feature_set(), reads);
            let mut noise = Noise(11);
            for _ in 0..50 {
                let row = row(&mut noise);
                let expected = unpadded(&layers, activation, &row);
                let mut forecast_w = [0.0];
                network.predict(&[row], &mut forecast_w);
                let reference = (exact::forecast_w(&network, &row) - expected).abs() / POWER.1;
                let kernel = (f64::from(forecast_w[0]) - expected).abs() / POWER.1;
                // A float of 49 W has a unit of 4e-6 in the last place.
                let what = format!("{widths:?} {activation:?}: {reference:e} {kernel:e}");
                assert!(reference < 1e-12 && kernel < 6e-6, "{what}");
            }
        }
    }
}

#[test]
fn range_residuals_and_scores_are_those_on_the_recordings_and_the_card_says_so() {
    let layers = layers(&[11, 20, 1], 3);
    let mut contents = contents(&layers, Activation::Relu, FEATURES);
    contents.metadata.insert("source".to_owned(), "theirs.pt".to_owned());
    let trial = recorded(400, 0.5, |features| unpadded(&layers, Activation::Relu, features));
    let plain = Plain::read(&contents.bytes()).unwrap();
    let network = plain.import(&[trial], "lab", "x.safetensors").unwrap().network;
    let card = network.card();
    assert_contains(&card.source, ["x.safetensors", "theirs.pt", "derivative=\"own-per-second\""]);
    assert_eq!((card.name.as_str(), card.scores.rows), ("lab", 395));
    let residual = card.residual;
    // Uniform noise of half a watt.
    assert!((0.2..0.4).contains(&residual.std_w), "{residual:?}");
    assert!(residual.q05_w < -0.3 && residual.q95_w > 0.3, "{residual:?}");
    let (min, max) = (card.training_range.min, card.training_range.max);
    assert!(min[0] < max[0] && max[0] <= 0.7 && min[6] > 30.0 && max[6] < 70.0);
    assert!((card.period_s().unwrap() - 1.0 / 30.0).abs() < 1e-4);
}

#[test]
fn a_larger_network_is_refused_with_its_widths_and_the_allowed_ones() {
    for (widths, shown) in [
        (&[11, 128, 64, 32, 1][..], "11→128→64→32→1"),
        (&[11, 64, 64, 64, 1], "11→64→64→64→1"),
        (&[11, 65, 1], "11→65→1"),
        (&[11, 32, 32, 32, 32, 1], "11→32→32→32→32→1"),
        (&[9, 64, 64, 32, 1], "9→64→64→32→1"),
        (&[13, 64, 64, 32, 1], "13→64→64→32→1"),
        (&[11, 8, 2], "11→8→2"),
        (&[11, 1], "11→1"),
    ] {
        let contents = contents(&layers(widths, 3), Activation::Relu, FEATURES);
        let error = Plain::read(&contents.bytes()).unwrap_err().to_string();
        assert_contains(&error, [shown, "64, 64 and 32"]);
    }
}

#[test]
fn each_part_that_is_missing_wrong_or_unknown_is_named_with_what_is_allowed() {
    type Change = fn(&mut Contents);
    let whole = contents(&layers(&[11, 8, 4, 1], 3), Activation::Relu, FEATURES);
    assert!(Plain::read(&whole.bytes()).is_ok());
    let changes: [(Change, &[&str]); 17] = [
        (|c| drop(c.metadata.remove("unit")), &["\"unit\" is missing", "W, mW"]),
        (
            |c| drop(c.metadata.remove("magnitude")),
            &["\"magnitude\" is missing", "own, as-velocity"],
        ),
        (|c| drop(c.metadata.insert("unit".into(), "kW".into())), &["is \"kW\"", "W, mW"]),
        (|c| drop(c.metadata.insert("lag_order".into(), String::new())), &["newest-first"]),
        (|c| drop(c.metadata.insert("lags".into(), "middle".into())), &["last, first"]),
        (|c| drop(c.metadata.insert("derivative".into(), "per-second".into())), &["own-per-step"]),
        (
            |c| drop(c.metadata.insert("magnitude".into(), "of-normalised".into())),
            &["is \"of-normalised\", allowed: own, as-velocity, divided, raw"],
        ),
        (
            |c| drop(c.metadata.insert("activation".into(), "tanh".into())),
            &["is \"tanh\"", "gelu_erf, gelu_tanh, relu"],
        ),
        (|c| drop(c.tensors.remove("layers.0.weight")), &["\"layers.0.weight\" is missing"]),
        (|c| drop(c.tensors.remove("layers.1.bias")), &["\"layers.1.bias\" is missing"]),
        (|c| drop(c.tensors.remove("power_std")), &["\"power_std\" is missing"]),
        (
            |c| drop(c.tensors.insert("norm.weight".into(), (vec![8], vec![1.0; 8]))),
            &["\"norm.weight\" belongs to no network"],
        ),
        (
            |c| drop(c.tensors.insert("feature_std".into(), (vec![6], vec![1.0; 6]))),
            &["\"feature_std\" has shape [6], allowed: 11 numbers"],
        ),
        (
            |c| drop(c.tensors.insert("layers.1.weight".into(), (vec![8, 4], vec![1.0; 32]))),
            &["\"layers.1.weight\" has shape [8, 4], allowed: (outputs, 8)"],
        ),
        (
            |c| c.tensors.get_mut("layers.1.bias").unwrap().1[2] = 1e300,
            &["\"layers.1.bias\" has 1", "at position 2", "finite"],
        ),
        (
            |c| c.tensors.get_mut("feature_mean").unwrap().1[3] = f64::NAN,
            &["\"feature_mean\" has NaN at position 3"],
        ),
        (
            |c| c.tensors.get_mut("power_std").unwrap().1[0] = -1.0,
            &["\"power_std\" has -1 at position 0, allowed: finite numbers from 0"],
        ),
    ];
    for (change, expected) in changes {
        let mut changed = whole.clone();
        change(&mut changed);
        let error = Plain::read(&changed.bytes()).unwrap_err().to_string();
        assert_contains(&error, expected.iter().copied());
    }
    // By statistics of its own there is nothing to compare. By those of the velocity there is.
    let mut other = whole.clone();
    other.metadata.insert("derivative".into(), "normalised-per-step".into());
    other.metadata.insert("magnitude".into(), "divided".into());
    let error = Plain::read(&other.bytes()).unwrap_err().to_string();
    assert_contains(
        &error,
        ["input 2 of feature_mean and feature_std is 0.01 and 0.5", "0 and 0.2"],
    );
}

#[test]
fn a_damaged_file_is_an_error_or_a_sound_network() {
    let whole = contents(&layers(&[11, 8, 1], 3), Activation::Relu, FEATURES).bytes();
    for end in 0..whole.len() {
        assert!(Plain::read(&whole[..end]).is_err(), "{end}");
    }
    let mut noise = Noise(17);
    for _ in 0..3_000 {
        let mut damaged = whole.clone();
        let at = noise.next_u64() as usize % damaged.len();
        damaged[at] ^= 1 << (noise.next_u64() % 8);
        match Plain::read(&damaged) {
            Ok(plain) => assert_eq!(plain.widths(), [11, 8, 1]),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
    let error = Plain::read(&vec![b'{'; (1 << 20) + 1]).unwrap_err().to_string();
    assert_contains(&error, ["1048577 bytes", "1048576"]);
}
