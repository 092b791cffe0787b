//! Rows to learn from are what the live tick shows the model.

use joulebus_lab::evaluate::evaluate;
use joulebus_lab::rows::trial_rows;
use joulebus_lab::trial::Trial;
use joulebus_predictor::{Features, Model, Network};

use crate::model::{ROBOTINO, settings};

/// A trial of `rows` rows with gaps where `gaps` says so and missing readings where `missing` does.
fn write_trial(folder: &std::path::Path, gaps: &[usize], missing: &[usize]) -> Trial {
    let path = folder.join("trial.csv");
    let mut text = "timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW\n".to_owned();
    let mut at_s = 0.0;
    for row in 0..120_usize {
        at_s += if gaps.contains(&row) {
            0.2
        } else {
            0.033 + 0.001 * (row % 3) as f64
        };
        let power = match missing.contains(&row) {
            true => "NaN".to_owned(),
            false => (3_500 + 40 * (row * 7 % 13)).to_string(),
        };
        let (v, omega) = (0.1 * (row % 4) as f64, 0.5 - 0.1 * (row % 9) as f64);
        text += &format!("{at_s:.4},{v},{omega},{power}\n");
    }
    std::fs::write(&path, text).expect("a temporary directory can be written to");
    Trial::read(&path).expect("sound")
}

fn shipped() -> Model {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../configs/models/gternal-sim.safetensors"
    );
    let bytes = std::fs::read(path).expect("the model is in the repository");
    Model::Network(Network::from_safetensors(&bytes).expect("sound"))
}

#[test]
fn a_row_has_the_features_that_the_live_tick_shows_the_model() {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let trial = write_trial(folder.path(), &[40, 41, 90], &[60]);
    let rows = trial_rows(&trial);
    assert_eq!(rows.rows.len(), rows.sample_seq.len());
    assert!(rows.rows.len() > 80, "{}", rows.rows.len());
    let features: Vec<Features> = rows.rows.iter().map(|row| row.features).collect();
    let mut forecasts_w = vec![0.0; features.len()];
    shipped().predict(&features, &mut forecasts_w);

    let models = [shipped(), shipped(), shipped()];
    let live = evaluate(&settings(), &models, &[(ROBOTINO, trial)]).expect("one robot");
    let mut compared = 0;
    for ((seq, row), forecast_w) in rows.sample_seq.iter().zip(&rows.rows).zip(forecasts_w) {
        let step = &live.robots[0].steps[*seq as usize];
        assert_eq!(step.sample_seq, *seq);
        assert_eq!(
            step.power_w.map(f32::to_bits),
            Some(forecast_w.to_bits()),
            "sample {seq}"
        );
        let answer = &live.robots[0].steps[*seq as usize + 1];
        assert_eq!(answer.reading_w, Some(row.target_w), "sample {seq}");
        compared += 1;
    }
    assert!(compared > 80);
}
