//! Training rows equal the features that the live tick passes to the model.

use joulebus_config::builtin_model;
use joulebus_dataset::rows::trial_rows;
use joulebus_dataset::split::Split;
use joulebus_dataset::trial::{ColumnMap, Trial};
use joulebus_eval::evaluate::evaluate;
use joulebus_eval::score::read_recordings;
use joulebus_eval::training_data::{MAX_ROWS, Parts, training_data};
use joulebus_predictor::{FEATURES, FeatureSet, Features, Model, Network};
use joulebus_testkit::recordings::trials;
use joulebus_wire::{InvalidReason, Quality};

use super::model::{ROBOTINO, network, settings};

/// A trial of 120 rows with gaps at `gaps` and missing readings at `missing`; a new reading comes
/// every `hold` rows, and once a row later. Gaps at multiples of ten exceed what the tick bridges.
fn write_trial(folder: &std::path::Path, hold: usize, gaps: &[usize], missing: &[usize]) -> Trial {
    let path = folder.join("trial.csv");
    let mut text = "timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW\n".to_owned();
    let mut at_s = 0.0;
    for row in 0..120_usize {
        at_s += if gaps.contains(&row) {
            if row % 10 == 0 { 0.34 } else { 0.2 }
        } else {
            0.033 + 0.001 * (row % 3) as f64
        };
        let power = match missing.contains(&row) {
            true => "NaN".to_owned(),
            false => {
                let measured = (row - usize::from(row > 70)) / hold;
                (3_500 + 40 * (measured * 7 % 13)).to_string()
            }
        };
        let (v, omega) = (0.1 * (row % 4) as f64, 0.5 - 0.1 * (row % 9) as f64);
        text += &format!("{at_s:.4},{v},{omega},{power}\n");
    }
    std::fs::write(&path, text).expect("a temporary directory can be written to");
    Trial::read(&path).expect("sound")
}

fn shipped() -> Model {
    let path =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/models/gternal-sim.safetensors");
    let bytes = std::fs::read(path).expect("the model is in the repository");
    Model::Network(Network::from_safetensors(&bytes).expect("sound"))
}

#[test]
fn a_row_has_the_features_of_the_live_tick() {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let fresh = [FeatureSet::Freshness, FeatureSet::PowerFreshness];
    for hold in [1, 3, 4] {
        for (gaps, missing) in
            [(&[41, 42, 97][..], &[60][..]), (&[2, 50], &[1, 3, 80, 81, 82]), (&[30, 31, 90], &[])]
        {
            let trial = write_trial(folder.path(), hold, gaps, missing);
            compare(&trial, &shipped());
            for set in fresh {
                compare(&trial, &network(4, set, 3.5));
            }
        }
    }
}

/// The model's forecast for each row equals the tick's after its sample, to the bit.
fn compare(trial: &Trial, model: &Model) {
    let rows = trial_rows(trial);
    assert_eq!(rows.rows.len(), rows.sample_seq.len());
    assert!(rows.rows.len() > 70, "{}", rows.rows.len());
    let features: Vec<Features> = rows.rows.iter().map(|row| row.features).collect();
    let mut forecasts_w = vec![0.0; features.len()];
    model.predict(&features, &mut forecasts_w);

    let models = [model.clone(), model.clone(), model.clone()];
    let mut settings = settings();
    for platform in &mut settings.platforms {
        platform.period_ns = trial.period_ns();
        platform.stale_after_ns = 5 * trial.period_ns();
    }
    let live = evaluate(&settings, &models, &[(ROBOTINO, trial.clone())]).expect("one robot");
    let mut compared = 0;
    for ((seq, row), forecast_w) in rows.sample_seq.iter().zip(&rows.rows).zip(forecasts_w) {
        let step = &live.robots[0].steps[*seq as usize];
        assert_eq!(step.sample_seq, *seq);
        if model.needs_freshness() && row.features[FEATURES].is_nan() {
            assert_eq!(step.quality, Quality::Invalid(InvalidReason::NoFreshness));
            assert_eq!(step.power_w, None);
            continue;
        }
        assert_eq!(step.power_w.map(f32::to_bits), Some(forecast_w.to_bits()), "sample {seq}");
        let answer = &live.robots[0].steps[*seq as usize + 1];
        assert_eq!(answer.reading_w, Some(row.target_w), "sample {seq}");
        compared += 1;
    }
    assert!(compared > 70, "{compared}");
}

#[test]
fn the_shipped_models_of_real_robots_were_trained_on_these_recordings() {
    for (name, folder) in
        [("robotino", "robotino"), ("husky", "borealtc_husky"), ("rover", "ase_rover")]
    {
        let Some(paths) = trials(folder) else {
            return;
        };
        let files: Vec<_> = paths.into_iter().map(|path| (0, path)).collect();
        let recordings = read_recordings(&files, &ColumnMap::default()).unwrap();
        let parts = Parts::Split(&recordings, Split::default());
        let (dataset, _) = training_data(parts, MAX_ROWS.get()).unwrap();
        let (_, bytes) = builtin_model(name).unwrap();
        let network = Network::from_safetensors(bytes).unwrap();
        let card = network.card();
        let digest = dataset.sha256(network.feature_set());
        assert_eq!(card.training_data_sha256, digest, "{name}: python3 tools/recorded_models.py");
        assert_eq!(card.training_data, dataset.description);
        assert_eq!(card.step_s, Some(dataset.period_s), "{name}");
    }
}
