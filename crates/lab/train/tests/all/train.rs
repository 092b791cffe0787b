//! Training is reproducible, learns, and refuses bad data; the shipped models match their stated
//! origin.

use joulebus_dataset::rows::{Dataset, Row, RowOrigin, sample_rows};
use joulebus_plant::protocol::SAMPLES;
use joulebus_predictor::{
    FEATURES, FeatureSet, Features, Kernel, ModelCard, Network, ResidualStats, Scores,
};
use joulebus_sim::training_data::{SimulatedData, dataset_from_plant};
use joulebus_testkit::assert_contains;
use joulebus_testkit_fleets::exact;
use joulebus_train::{
    Epoch, TrainError, TrainReport, TrainSettings, Trained, Training, scored, settings_for_sim,
    train,
};
use joulebus_wire::{Sample, sample_flag};
use std::path::Path;
use std::time::Duration;

/// The seed in the documented command.
const SHIPPED_SEED: u64 = 7;

const SHIPPED: [(&str, FeatureSet); 3] = [
    ("gternal-sim.safetensors", FeatureSet::Full),
    ("gternal-sim-power.safetensors", FeatureSet::PowerOnly),
    ("gternal-sim-freshness.safetensors", FeatureSet::Freshness),
];

fn tiny_data() -> Dataset {
    dataset_from_plant(SimulatedData {
        seed: 11,
        training_robots: 4,
        validation_robots: 2,
        held_out_robots: 2,
        full_speed_robots: 0,
        ticks: 300,
    })
}

fn tiny_settings(feature_set: FeatureSet) -> TrainSettings {
    TrainSettings { max_epochs: 4, ..TrainSettings::new("tiny", "simulation", feature_set, 12) }
}

fn made(data: &Dataset, settings: &TrainSettings) -> Trained {
    train(data, settings, |_| ()).expect("sound data")
}

fn refused(data: &Dataset, settings: &TrainSettings) -> TrainError {
    train(data, settings, |_| ()).expect_err("must be refused")
}

fn bytes(network: &Network) -> Vec<u8> {
    network.to_safetensors().expect("valid")
}

fn tiny(feature_set: FeatureSet) -> Trained {
    made(&tiny_data(), &tiny_settings(feature_set))
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_every_machine() {
    for (feature_set, hash) in
        [(FeatureSet::Full, FULL_HASH), (FeatureSet::PowerOnly, POWER_ONLY_HASH)]
    {
        let [one, other] = [tiny(feature_set).network, tiny(feature_set).network];
        assert_eq!(bytes(&one), bytes(&other));
        let found = one.hash();
        // If plant or trainer were changed on purpose: update this hash, and retrain the shipped
        // models.
        assert_eq!(found, hash, "{found:#018x}");
    }
    let settings = TrainSettings { seed: 13, ..tiny_settings(FeatureSet::Full) };
    let other = made(&tiny_data(), &settings);
    assert_ne!(other.network.hash(), FULL_HASH);
}

#[test]
fn held_out_rows_that_were_also_trained_on_are_not_scored_and_their_share_is_stated() {
    let settings = tiny_settings(FeatureSet::Full);
    let data = tiny_data();
    let honest = made(&data, &settings);
    assert_eq!(honest.findings.held_out_trained_on, 0);
    // A copy of training rows, two rows shorter, among those held out.
    let mut copied = data.clone();
    copied.held_out.extend_from_slice(&data.training[..200]);
    let trained = made(&copied, &settings);
    let (card, known) = (trained.network.card(), trained.findings.held_out_trained_on);
    // Rows beside the copy count too, as they may share readings with it.
    assert!((200..=216).contains(&known), "{known}");
    assert_eq!(card.scores.rows, (copied.held_out.len() - known) as u64);
    let stated = format!("{known} of {} held-out rows", copied.held_out.len());
    assert_contains(&card.training_data, [&*stated]);
    assert_contains(&report(&trained), [&*format!("{known} held-out rows were also trained on")]);
    // Nothing else is held out.
    copied.held_out.clone_from(&data.training);
    let error = refused(&copied, &settings);
    assert!(matches!(error, TrainError::HeldOutTrainedOn { .. }), "{error}");
}

/// The readings of a part's first run, recorded again as another recording.
fn recorded_again(rows: &[Row], recording: usize, change: impl Fn(&[f32]) -> Vec<f32>) -> Vec<Row> {
    let readings_w: Vec<f32> = rows.iter().map(|row| row.target_w).collect();
    let samples = (1..).zip(change(&readings_w)).map(|(seq, power_w)| {
        let stamp_ns = seq * 33_000_000;
        Sample::new(0, seq, stamp_ns).command(0.2, 0.1).reading(power_w, stamp_ns)
    });
    let samples: Vec<Sample> = samples.collect();
    let rows = sample_rows(&samples, 33_000_000).rows;
    rows.iter().map(|row| row.of(RowOrigin::recording(recording))).collect()
}

fn report(trained: &Trained) -> String {
    TrainReport::new(None, trained, Duration::ZERO, None).to_string()
}

#[test]
fn a_held_out_recording_that_is_a_copy_in_good_part_goes_whole_and_short_pieces_are_counted() {
    let settings = tiny_settings(FeatureSet::PowerOnly);
    let data = tiny_data();
    let copied = &data.training[..290];
    let held_out = |rows: Vec<Row>| Dataset {
        held_out: [data.held_out.clone(), rows].concat(),
        ..data.clone()
    };
    let honest = made(&data, &settings).findings;
    for (what, range) in [
        ("two rows shorter", 1..289),
        ("an excerpt", 101..260),
        ("an excerpt that misses its blocks at both ends", 30..270),
    ] {
        let copy = recorded_again(copied, 99, |powers_w| powers_w[range.clone()].to_vec());
        let trained = made(&held_out(copy.clone()), &settings);
        let known = trained.findings.held_out_trained_on;
        assert_eq!(known, copy.len(), "{what}");
        assert_eq!(trained.findings.held_out_untold, honest.held_out_untold, "{what}");
        assert_eq!(trained.network.card().scores.rows, data.held_out.len() as u64, "{what}");
    }
    // Two blocks of a copy, then a long drive of another robot: only the copy goes.
    let joined = |powers_w: &[f32]| {
        let other = data.held_out[..290].iter().chain(&data.held_out[300..590]);
        let other = other.map(|row| row.target_w * 1.2);
        powers_w[..200].iter().copied().chain(other).collect()
    };
    let joined = recorded_again(copied, 99, joined);
    let known = made(&held_out(joined), &settings).findings.held_out_trained_on;
    assert!((128..=160).contains(&known), "{known}");
    // Too short for a whole block.
    let short = recorded_again(copied, 99, |powers_w| powers_w[70..130].to_vec());
    let trained = made(&held_out(short.clone()), &settings);
    let findings = &trained.findings;
    assert_eq!(findings.held_out_trained_on, 0);
    assert_eq!(findings.held_out_untold, honest.held_out_untold + short.len());
    let stated = format!("{} held-out rows cannot be told", findings.held_out_untold);
    assert_contains(&report(&trained), [&*stated]);
}

#[test]
fn validation_rows_that_were_also_trained_on_are_stated_in_the_report_and_the_card() {
    let settings = tiny_settings(FeatureSet::Full);
    let mut data = tiny_data();
    assert_eq!(made(&data, &settings).findings.validation_trained_on, 0);
    let rows = data.validation.len();
    data.validation.extend_from_slice(&data.training[..200]);
    let trained = made(&data, &settings);
    let known = trained.findings.validation_trained_on;
    assert!((200..=216).contains(&known), "{known}");
    let stated = format!("{known} of {} validation rows", rows + 200);
    assert_contains(&trained.network.card().training_data, [&*stated]);
    assert_contains(&report(&trained), [&*format!("{known} validation rows")]);
    assert_eq!(trained.findings.held_out_trained_on, 0);
}

#[test]
fn training_reports_its_progress_and_the_losses_fall() {
    let mut reported: Vec<Epoch> = Vec::new();
    let settings = tiny_settings(FeatureSet::Full);
    let trained = train(&tiny_data(), &settings, |epoch| reported.push(epoch)).expect("sound data");
    assert_eq!(reported, trained.epochs);
    let (first, last) = (reported[0], reported[reported.len() - 1]);
    assert!(last.training_loss < 0.7 * first.training_loss, "{reported:?}");
    assert!(last.validation_loss < first.validation_loss, "{reported:?}");
}

#[test]
fn training_stops_early_and_keeps_the_best_epoch() {
    let mut data = tiny_data();
    data.training.truncate(256);
    let settings = TrainSettings {
        patience: 2,
        max_epochs: 5_000,
        dropout: 0.0,
        ..tiny_settings(FeatureSet::PowerOnly)
    };
    let trained = made(&data, &settings);
    let best = trained.epochs.iter().rposition(|epoch| epoch.best);
    let best = best.expect("the first is best");
    // Two epochs without improvement stop it.
    assert_eq!(trained.epochs.len(), best + 3);
    let (scores, _) = scored(&trained.network, &data.validation);
    let loss = (1.0 - f64::from(scores.network_r2)) * variance(&data.validation);
    let scale = f64::from(trained.network.parameters().normalisation.power_std_w);
    let expected = trained.epochs[best].validation_loss;
    let off = (loss / (scale * scale) - expected).abs();
    assert!(off < 1e-3 * expected, "{loss} {expected}");
}

fn variance(rows: &[Row]) -> f64 {
    let count = rows.len() as f64;
    let powers = rows.iter().map(|row| f64::from(row.target_w));
    let mean = powers.clone().sum::<f64>() / count;
    powers.map(|power| (power - mean).powi(2)).sum::<f64>() / count
}

#[test]
fn unusable_data_is_refused_with_its_part_and_numbers() {
    let data = tiny_data();
    let full = tiny_settings(FeatureSet::Full);

    let mut short = data.clone();
    short.training.truncate(1);
    assert_contains(&refused(&short, &full), ["training part has 1 usable rows (0 more"]);

    let mut poisoned = data.clone();
    for row in &mut poisoned.validation {
        row.features[1] = f32::NAN;
    }
    let unusable = poisoned.validation.len();
    let part = format!("has 0 usable rows ({unusable} more have a NaN");
    assert_contains(&refused(&poisoned, &full), [part]);
    // Velocities are not read.
    made(&poisoned, &tiny_settings(FeatureSet::PowerOnly));

    let mut constant = data.clone();
    let targets = constant.training.iter_mut();
    targets.for_each(|row| row.target_w = 3.0);
    let result = refused(&constant, &full);
    let is_constant = matches!(result, TrainError::ConstantPower { rows: 1_180, .. });
    assert!(is_constant, "{result:?}");

    type Spoil = fn(&mut TrainSettings);
    let spoiled: [(&str, Spoil); 9] = [
        ("dropout", |s| s.dropout = -0.1),
        ("dropout", |s| s.dropout = 1.0),
        ("dropout", |s| s.dropout = f64::NAN),
        ("max_epochs", |s| s.max_epochs = 0),
        ("batch", |s| s.batch = 0),
        ("learning_rate", |s| s.learning_rate = f64::NAN),
        ("first_moment", |s| s.first_moment = 1.0),
        ("second_moment", |s| s.second_moment = f64::INFINITY),
        ("epsilon", |s| s.epsilon = 0.0),
    ];
    for (knob, spoil) in spoiled {
        let mut settings = full.clone();
        spoil(&mut settings);
        assert_contains(&refused(&data, &settings), [knob]);
    }
    let settings = TrainSettings {
        learning_rate: 1.0,
        epsilon: 1e-30,
        second_moment: 0.0,
        first_moment: 0.0,
        ..full
    };
    let mut huge = data.clone();
    huge.training[0].target_w = 3e38;
    // A loss that is not finite gives no network.
    refused(&huge, &settings);
}

#[test]
fn unusable_rows_are_left_out_counted_and_change_nothing_else() {
    let clean = tiny_data();
    let mut spoiled = clean.clone();
    let bad = |place: usize, value: f32| {
        let mut row = clean.training[0];
        row.features[place] = value;
        row
    };
    spoiled.training.insert(7, bad(0, f32::NAN));
    spoiled.training.insert(300, bad(6, f32::INFINITY));
    spoiled.held_out.push(bad(10, f32::NAN));
    let settings = tiny_settings(FeatureSet::Full);
    let [expected, found] = [clean.clone(), spoiled].map(|data| made(&data, &settings));
    assert_eq!(found.findings.unusable_rows, [2, 0, 1]);
    assert_eq!(found.findings.training_rows, clean.training.len());
    assert_eq!(found.network.parameters(), expected.network.parameters());
    // The file identifies recordings, whose unusable rows belong to them.
    let card =
        |trained: &Trained| ModelCard { trained_rows: None, ..trained.network.card().clone() };
    assert_eq!(card(&found), card(&expected));
}

#[test]
fn a_constant_feature_and_a_tiny_dataset_are_worked_around_and_named() {
    let mut data = tiny_data();
    data.training = data.training.into_iter().step_by(29).collect();
    for row in &mut data.training {
        row.features[1] = 0.25;
    }
    let trained = made(&data, &tiny_settings(FeatureSet::Full));
    assert_eq!(trained.findings.constant_features, ["omega_radps"]);
    assert!(trained.findings.few_rows);
    let mut inputs = [data.held_out[0].features; 2];
    inputs[1][1] = -3.0;
    let mut forecasts_w = [0.0; 2];
    trained.network.predict(&inputs, &mut forecasts_w);
    assert_eq!(forecasts_w[0], forecasts_w[1], "it has no effect");
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let data = tiny_data();
    let settings = tiny_settings(FeatureSet::Full);
    for threads in [257, usize::MAX] {
        let refused = Training::new(&data, &settings, threads).expect_err("too many");
        assert!(refused.to_string().contains("to 256"), "{refused}");
    }
    for batch in [256, 33, 5_000] {
        let settings = TrainSettings { batch, ..tiny_settings(FeatureSet::Full) };
        let bytes = [1, 2, 5].map(|threads| {
            let mut training = Training::new(&data, &settings, threads).expect("sound data");
            while !training.is_done() {
                training.epoch().expect("it does not diverge");
            }
            bytes(&training.finish().expect("sound").network)
        });
        assert!(bytes[0] == bytes[1] && bytes[0] == bytes[2], "{batch}");
    }
}

#[test]
fn a_run_saved_after_any_epoch_resumes_to_the_same_bytes() {
    let data = tiny_data();
    let settings = tiny_settings(FeatureSet::Full);
    let expected = made(&data, &settings);
    let training = Training::new(&data, &settings, 1).expect("sound data");
    let mut saved = training.saved();
    for epochs in 0..settings.max_epochs as usize {
        let mut training = Training::resume(&data, &settings, 2, &saved).expect("its own file");
        assert_eq!(training.epochs(), &expected.epochs[..epochs]);
        training.epoch().expect("it does not diverge");
        saved = training.saved();
    }
    let training = Training::resume(&data, &settings, 1, &saved).expect("its own file");
    assert!(training.is_done());
    let trained = training.finish().expect("sound");
    assert_eq!(trained.epochs, expected.epochs);
    assert_eq!(bytes(&trained.network), bytes(&expected.network));
}

#[test]
fn a_saved_run_resumes_only_with_its_own_data_and_recipe() {
    let data = tiny_data();
    let settings = tiny_settings(FeatureSet::Full);
    let mut training = Training::new(&data, &settings, 1).expect("sound data");
    training.epoch().expect("it does not diverge");
    let saved = training.saved();
    let refused = |data: &Dataset, settings: &TrainSettings, saved: &[u8]| {
        let error = Training::resume(data, settings, 1, saved).expect_err("must be refused");
        error.to_string()
    };
    let mut other = data.clone();
    other.training[0].target_w += 0.5;
    assert!(refused(&other, &settings, &saved).contains("another data hash"));
    let faster = TrainSettings { learning_rate: 2e-3, ..settings.clone() };
    assert!(refused(&data, &faster, &saved).contains("another recipe"));
    let longer = TrainSettings { max_epochs: 9, ..settings.clone() };
    // The number of epochs may be raised.
    assert!(Training::resume(&data, &longer, 1, &saved).is_ok());
    for cut in (0..saved.len()).step_by(97) {
        refused(&data, &settings, &saved[..cut]);
    }
    let mut poisoned = saved.clone();
    let end = poisoned.len();
    poisoned[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(refused(&data, &settings, &poisoned).contains("NaN"));
}

#[test]
fn a_row_pairs_the_command_and_readings_of_a_tick_with_the_next_reading() {
    use joulebus_plant::Plant;
    use joulebus_plant::protocol::Protocol;
    let data = dataset_from_plant(SimulatedData {
        seed: 14,
        training_robots: 1,
        validation_robots: 0,
        held_out_robots: 0,
        full_speed_robots: 0,
        ticks: 60,
    });
    let mut plant = Plant::driving(14, [Protocol::Structured]);
    let readings: Vec<_> = (0..60).map(|_| plant.step(1.0 / 30.0)[0]).collect();
    assert_eq!(data.training.len(), 55);
    for (row, window) in data.training.iter().zip(readings.windows(6)) {
        assert_eq!(row.target_w, window[5].power_w);
        assert_eq!(row.features[0], window[4].v_mps);
        assert_eq!(row.features[1], window[4].omega_radps);
        let before = window[..5].iter().rev();
        let lag_w: Vec<f32> = before.map(|reading| reading.power_w).collect();
        assert_eq!(row.features[6..FEATURES], lag_w);
    }
}

/// The rows with all inputs of a network. At a robot's first samples the reading age is unknown.
fn usable(dataset: &Dataset, feature_set: FeatureSet) -> Dataset {
    let known = |rows: &[Row]| -> Vec<Row> {
        let read = |row: &&Row| row.features[feature_set.range()].iter().all(|x| x.is_finite());
        rows.iter().filter(read).copied().collect()
    };
    Dataset {
        training: known(&dataset.training),
        validation: known(&dataset.validation),
        held_out: known(&dataset.held_out),
        ..dataset.clone()
    }
}

fn shipped(name: &str) -> Network {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../configs/models");
    let bytes = std::fs::read(folder.join(name)).expect("the model is in the repository");
    Network::from_safetensors(&bytes).expect("the model passes every check")
}

#[test]
fn the_shipped_models_state_that_they_come_from_this_simulation() {
    let all = dataset_from_plant(SimulatedData::shipped(SHIPPED_SEED));
    for (name, feature_set) in SHIPPED {
        let network = shipped(name);
        let card = network.card();
        let expected = usable(&all, feature_set);
        assert_eq!(network.feature_set(), feature_set);
        assert_eq!(card.source, "simulation");
        assert_eq!(card.seed, SHIPPED_SEED);
        assert_eq!(card.training_data, expected.description);
        let digest = expected.sha256(feature_set);
        assert_eq!(card.training_data_sha256, digest, "{name} is too old");
        let (scores, residual) = scored(&network, &expected.held_out);
        // The card was written by earlier kernels: their last bits may change, the model's may not.
        // Its quantiles are those of a row, not between two.
        let close = |(found, stated): (f32, f32)| (found - stated).abs() <= 1e-3 * stated.abs();
        let figures = |scores: Scores, residual: ResidualStats| {
            let ResidualStats { std_w, q05_w, q95_w } = residual;
            let network = [scores.network_r2, scores.network_mae_w];
            let persistence = [scores.persistence_r2, scores.persistence_mae_w];
            [&network[..], &persistence, &[std_w, q05_w, q95_w]].concat()
        };
        assert_eq!(scores.rows, card.scores.rows);
        let found = figures(scores, residual);
        let stated = figures(card.scores, card.residual);
        let mut pairs = found.iter().copied().zip(stated.iter().copied());
        assert!(pairs.all(close), "{found:?} {stated:?}");
    }
}

#[test]
fn the_shipped_models_are_reproduced_by_the_documented_command() {
    let dataset = dataset_from_plant(SimulatedData::shipped(SHIPPED_SEED));
    for (name, feature_set) in SHIPPED {
        let settings = settings_for_sim(SHIPPED_SEED, feature_set);
        let made = made(&dataset, &settings);
        assert_eq!(made.network.hash(), shipped(name).hash(), "{name}");
    }
}

#[test]
fn the_shipped_models_beat_persistence_on_held_out_robots() {
    let fresh = dataset_from_plant(SimulatedData {
        seed: 1_007,
        training_robots: 8,
        validation_robots: 4,
        held_out_robots: 4,
        full_speed_robots: 0,
        ticks: SAMPLES,
    });
    // Other robots, on every trial.
    let known = usable(&fresh, FeatureSet::Freshness);
    let rows = [known.training, known.validation, known.held_out].concat();
    for (name, _) in SHIPPED {
        let (scores, residual) = scored(&shipped(name), &rows);
        println!("{name}: {scores:?} {residual:?}");
        // Persistence reaches 2ρ − 1. The best forecast from the last reading alone reaches ρ² (the
        // paper's ceiling of such a process).
        let ceiling = ((1.0 + scores.persistence_r2) / 2.0).powi(2);
        assert!(scores.network_r2 > ceiling + 0.001, "{ceiling}: {scores:?}");
    }
}

#[test]
fn trained_weights_keep_every_kernel_within_3e_6_of_double_precision() {
    let rows = usable(&tiny_data(), FeatureSet::Freshness).held_out;
    for (name, _) in SHIPPED {
        let network = shipped(name);
        let scale_w = f64::from(network.parameters().normalisation.power_std_w);
        let inputs: Vec<Features> = rows.iter().map(|row| row.features).collect();
        let exact_w = exact::forecasts_w(&network, &inputs);
        for kernel in Kernel::ALL {
            let Some(network) = network.clone().with_kernel(kernel) else {
                continue;
            };
            let mut forecasts_w = vec![0.0; inputs.len()];
            network.predict(&inputs, &mut forecasts_w);
            for ((row, exact_w), forecast_w) in inputs.iter().zip(&exact_w).zip(forecasts_w) {
                let expected = network.predict_reference_f32(row);
                assert_eq!(forecast_w.to_bits(), expected.to_bits());
                let error_w = (f64::from(forecast_w) - exact_w).abs();
                assert!(error_w <= 3e-6 * scale_w, "{kernel:?} {name} {error_w:e}");
            }
        }
    }
}

/// A robot whose power alternates about 3 W with every tenth sample, when its monitor measures
/// again.
fn swinging(size_w: f32) -> Vec<Row> {
    const PERIOD_NS: u64 = 33_000_000;
    let samples: Vec<Sample> = (0..400)
        .map(|seq| {
            let stamp_ns = (seq + 1) * PERIOD_NS;
            let side = if seq / 10 % 2 == 0 { 1.0 } else { -1.0 };
            let sample = Sample::new(1, seq, stamp_ns).reading(3.0 + side * size_w, stamp_ns);
            sample.with(if seq % 10 == 0 { 0 } else { sample_flag::HELD })
        })
        .collect();
    sample_rows(&samples, PERIOD_NS).rows
}

#[test]
fn a_network_with_reading_age_learns_when_the_next_reading_comes() {
    let robots = |sizes: std::ops::Range<u8>| -> Vec<Row> {
        let size_w = |size: u8| 0.3 + 0.05 * f32::from(size);
        sizes.flat_map(|size| swinging(size_w(size))).collect()
    };
    let data = Dataset {
        training: robots(0..12),
        validation: robots(12..14),
        held_out: robots(14..17),
        description: "swinging".to_owned(),
        period_s: 0.0,
    };
    let trained = |set: FeatureSet| {
        let settings =
            TrainSettings { max_epochs: 30, ..TrainSettings::new("swinging", "made up", set, 3) };
        made(&data, &settings)
    };
    let plain = trained(FeatureSet::PowerOnly);
    let fresh = trained(FeatureSet::PowerFreshness);
    // Until two measurements have been seen the reading age is unknown: six rows per robot, of
    // those with a full window.
    assert_eq!(plain.findings.unusable_rows, [0; 3]);
    assert_eq!(fresh.findings.unusable_rows, [12 * 6, 2 * 6, 3 * 6]);
    let r2 = |trained: &Trained| trained.network.card().scores.network_r2;
    println!("R²: {} without, {} with", r2(&plain), r2(&fresh));
    assert!(r2(&plain) < 0.8 && r2(&fresh) > 0.97);

    let again = trained(FeatureSet::PowerFreshness);
    assert_eq!(bytes(&again.network), bytes(&fresh.network));
}

/// Hashes of the tiny networks, from this trainer on x86-64.
const FULL_HASH: u64 = 0x167b_e7e1_9b72_3e8d;
const POWER_ONLY_HASH: u64 = 0x91a4_2637_01fb_0344;
