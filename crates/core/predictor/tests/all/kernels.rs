//! The promise of one arithmetic: every kernel, batch size and position gives the reference's bits.

use joulebus_predictor::{
    FEATURES, FeatureSet, Features, INPUTS, Kernel, Model, Network, Persistence, ReadingAge,
    ResidualStats, Tiling, features,
};
#[allow(dead_code)] // Each test file uses a part.
use joulebus_testkit_fleets::random::{Noise, network, row};
use joulebus_testkit_fleets::{exact, random};
use proptest::prelude::*;
use std::path::Path;

const SETS: [FeatureSet; 4] = FeatureSet::ALL;

/// The network on every kernel that this CPU supports, in every tiling.
fn kernels(network: &Network) -> Vec<Network> {
    let tilings = [Tiling::ByInput, Tiling::BatchMajor, Tiling::OutputMajor];
    let all = Kernel::ALL.into_iter();
    all.filter_map(|kernel| network.clone().with_kernel(kernel))
        .flat_map(|network| tilings.map(|tiling| network.clone().with_tiling(tiling)))
        .collect()
}

fn trained() -> Vec<Network> {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../configs/models");
    ["gternal-sim.safetensors", "gternal-sim-power.safetensors"]
        .map(|name| {
            let bytes = std::fs::read(models.join(name)).expect("the shipped models exist");
            Network::from_safetensors(&bytes).expect("the shipped models are valid")
        })
        .into()
}

/// A row as in training: near the mean, and within the range.
fn usual_row(network: &Network, noise: &mut Noise) -> Features {
    let range = network.card().training_range;
    let normalisation = network.parameters().normalisation;
    std::array::from_fn(|feature| {
        let deviations: f32 = (0..4).map(|_| noise.next_f32()).sum();
        (normalisation.feature_mean[feature] + deviations * normalisation.feature_std[feature])
            .clamp(range.min[feature], range.max[feature])
    })
}

/// A random row within the training range: most have a reading a dozen deviations from the mean,
/// next to others that are not.
fn row_in_range(network: &Network, noise: &mut Noise) -> Features {
    let range = network.card().training_range;
    std::array::from_fn(|feature| {
        let share = 0.5 + 0.5 * noise.next_f32();
        range.min[feature] + share * (range.max[feature] - range.min[feature])
    })
}

fn reference(network: &Network, rows: &[Features]) -> Vec<u32> {
    rows.iter().map(|row| network.predict_reference_f32(row).to_bits()).collect()
}

fn batched(network: &Network, rows: &[Features]) -> Vec<u32> {
    let mut out_w = vec![-1.0; rows.len()];
    network.predict(rows, &mut out_w);
    out_w.into_iter().map(f32::to_bits).collect()
}

#[test]
fn the_shorter_slice_decides_and_the_rest_is_unchanged() {
    let rows: Vec<Features> = (0..40).map(|_| row(&mut Noise(3))).collect();
    for network in kernels(&network(1, FeatureSet::Full)) {
        let mut longer = [-1.0; 45];
        network.predict(&rows, &mut longer);
        assert!(longer[..40].iter().all(|w| *w != -1.0) && longer[40..] == [-1.0; 5]);
        let mut shorter = [-1.0; 33];
        network.predict(&rows, &mut shorter);
        assert_eq!(shorter, longer[..33]);
    }
}

/// Numerically difficult values, and any other bit pattern.
fn value() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -10.0f32..10.0,
        1 => any::<u32>().prop_map(f32::from_bits),
        1 => prop::sample::select(vec![
            f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN,
            f32::MIN_POSITIVE, 1e-45, -1e-45, 0.0, -0.0, 1e38, -1e38, 5.5, -5.5, 65_504.0,
        ]),
    ]
}

proptest! {
    #[test]
    fn any_rows_give_the_reference_bits_on_every_kernel(
        seed in 0u64..50,
        rows in prop::collection::vec(prop::array::uniform13(value()), 0..70),
    ) {
        for set in SETS {
            let network = network(seed, set);
            let expected = reference(&network, &rows);
            for network in kernels(&network) {
                prop_assert_eq!(&batched(&network, &rows), &expected, "{:?}", network.kernel());
            }
        }
    }

    #[test]
    fn an_invalid_row_gives_nan_and_changes_no_other_row(
        count in 1usize..70,
        position in any::<prop::sample::Index>(),
        feature in 0usize..INPUTS,
        poison in prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY]),
    ) {
        let mut noise = Noise(4);
        let clean: Vec<Features> = (0..count).map(|_| row(&mut noise)).collect();
        let position = position.index(count);
        let mut poisoned = clean.clone();
        poisoned[position][feature] = poison;
        for set in SETS {
            for network in kernels(&network(5, set)) {
                let expected = batched(&network, &clean);
                let found = batched(&network, &poisoned);
                for (index, (found, expected)) in found.iter().zip(&expected).enumerate() {
                    if index == position && set.range().contains(&feature) {
                        prop_assert!(!f32::from_bits(*found).is_finite());
                    } else {
                        prop_assert_eq!(found, expected);
                    }
                }
            }
        }
    }
}

/// Largest error against double precision, as a share of `scale_w` of the exact forecast.
fn worst_error(network: &Network, rows: &[Features], scale_w: impl Fn(f64) -> f64) -> f64 {
    let mut out_w = vec![0.0; rows.len()];
    network.predict(rows, &mut out_w);
    let errors = exact::forecasts_w(network, rows)
        .into_iter()
        .zip(out_w)
        .map(|(exact_w, forecast_w)| (f64::from(forecast_w) - exact_w).abs() / scale_w(exact_w));
    errors.fold(0.0, f64::max)
}

fn output_scale_w(network: &Network) -> f64 {
    f64::from(network.parameters().normalisation.power_std_w)
}

#[test]
fn kernels_stay_within_3e_6_of_the_output_scale_of_double_precision() {
    let mut worst = 0.0f64;
    for seed in 0..20 {
        for set in SETS {
            let network = network(seed, set);
            let mut noise = Noise(seed + 100);
            let rows: Vec<Features> = (0..500).map(|_| row(&mut noise)).collect();
            worst = worst.max(worst_error(&network, &rows, |_| output_scale_w(&network)));
        }
    }
    println!("largest error: {worst:.2e} of the output scale");
    assert!(worst <= 3e-6, "{worst:e}");
}

#[test]
fn trained_networks_stay_within_3e_6_of_the_output_scale_of_double_precision() {
    for network in trained() {
        let name = &network.card().name;
        let mut noise = Noise(10);
        let usual = (0..20_000).map(|_| usual_row(&network, &mut noise));
        let usual = worst_error(&network, &usual.collect::<Vec<_>>(), |_| output_scale_w(&network));
        println!("{name}: {usual:.2e} of the output scale");
        assert!(usual <= 3e-6, "{name}: {usual:e}");
        // Far from the mean the forecast is many scales large, and its own last place is 3e-6 of
        // one.
        let all = (0..20_000).map(|_| row_in_range(&network, &mut noise));
        let scale_w = |exact_w: f64| output_scale_w(&network).max(exact_w.abs());
        let all = worst_error(&network, &all.collect::<Vec<_>>(), scale_w);
        println!("{name}: {all:.2e} of the scale or the forecast over the whole range");
        assert!(all <= 3e-6, "{name}: {all:e}");
    }
}

#[test]
fn trained_networks_give_the_reference_bits_on_every_kernel() {
    for network in trained() {
        let mut noise = Noise(11);
        let rows: Vec<Features> = (0..77).map(|_| row_in_range(&network, &mut noise)).collect();
        let expected = reference(&network, &rows);
        for network in kernels(&network) {
            assert_eq!(batched(&network, &rows), expected, "{:?}", network.kernel());
        }
    }
}

#[test]
fn a_constant_feature_is_ignored() {
    let mut parameters = random::parameters(&mut Noise(6), FeatureSet::Full);
    parameters.normalisation.feature_std[3] = 0.0;
    let network = Network::new(parameters, random::card(FeatureSet::Full)).expect("valid");
    let mut rows = [row(&mut Noise(7)); 2];
    rows[1][3] += 100.0;
    let found = batched(&network, &rows);
    assert_eq!(found[0], found[1]);
}

#[test]
fn a_network_that_needs_velocities_or_freshness_forecasts_nan_without_them() {
    let mut no_velocities = row(&mut Noise(8));
    no_velocities[..6].fill(f32::NAN);
    let mut no_freshness = row(&mut Noise(8));
    ReadingAge::UNKNOWN.fill(&mut no_freshness);
    let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
    let persistence = Persistence::new(residual).expect("valid");
    let network = |set| Model::Network(network(9, set));
    for (model, command, freshness) in [
        (network(FeatureSet::Full), true, false),
        (network(FeatureSet::PowerOnly), false, false),
        (network(FeatureSet::Freshness), true, true),
        (network(FeatureSet::PowerFreshness), false, true),
        (Model::Persistence(persistence), false, false),
    ] {
        let mut out_w = [0.0; 2];
        model.predict(&[no_velocities, no_freshness], &mut out_w);
        assert_eq!((model.needs_command(), model.needs_freshness()), (command, freshness));
        assert_eq!(out_w.map(f32::is_nan), [command, freshness], "{}", model.name());
    }
}

#[test]
fn persistence_repeats_the_newest_reading_and_refuses_bad_residuals() {
    let fine = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
    let model = Model::Persistence(Persistence::new(fine).expect("valid"));
    let row = features(0.1, 0.2, None, &[5.0, 4.0, 3.0, 2.0, 1.0]);
    let mut out_w = [0.0];
    model.predict(&[row], &mut out_w);
    assert_eq!(out_w, [5.0]);
    let columns = row.each_ref().map(std::slice::from_ref);
    model.predict_columns(columns, &mut out_w).expect("a value in each column");
    assert_eq!(out_w, [5.0]);
    assert_eq!(model.residual(), fine);
    assert!(model.training_range().is_none());
    for bad in [
        ResidualStats { std_w: f32::NAN, ..fine },
        ResidualStats { std_w: -0.1, ..fine },
        ResidualStats { q05_w: 0.3, ..fine },
        ResidualStats { q95_w: f32::INFINITY, ..fine },
    ] {
        assert!(Persistence::new(bad).is_err(), "{bad:?}");
    }
}

#[test]
fn features_are_differences_over_the_true_time_step() {
    let lag_w = [5.0, 4.0, 3.0, 2.0, 1.0];
    let first = features(-0.1, 2.0, None, &lag_w);
    assert!(first[FEATURES..].iter().all(|value| value.is_nan()));
    assert_eq!(first[..FEATURES], [-0.1, 2.0, 0.0, 0.0, 0.1, 2.0, 5.0, 4.0, 3.0, 2.0, 1.0]);
    let next = features(0.15, -1.0, Some((-0.1, 2.0, 0.5)), &lag_w);
    assert_eq!(next[..FEATURES], [0.15, -1.0, 0.5, -6.0, 0.15, 1.0, 5.0, 4.0, 3.0, 2.0, 1.0]);
    for dt_s in [0.0, -0.1, f32::NAN] {
        let row = features(0.15, -1.0, Some((-0.1, 2.0, dt_s)), &lag_w);
        assert!(row[2].is_nan() && row[3].is_nan(), "{dt_s}");
    }
}

#[test]
fn the_training_range_names_the_first_feature_outside() {
    let network = network(9, FeatureSet::PowerOnly);
    let range = network.card().training_range;
    let mut row = [0.0; INPUTS];
    row[0] = f32::NAN;
    assert_eq!(range.outside(&row, 0.0), None, "a power-only network has no range of velocities");
    for (value, outside) in [(2.5, None), (2.6, Some(8)), (f32::NAN, Some(8)), (-1.6, Some(8))] {
        row[8] = value;
        assert_eq!(range.outside(&row, 0.0), outside, "{value}");
    }
    row[8] = 2.6;
    assert_eq!(range.outside(&row, 0.1), None);
}
