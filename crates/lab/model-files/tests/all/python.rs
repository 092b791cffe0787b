//! An exported Python module makes the network's forecasts.

use std::process::Command;

use joulebus_model_files::{ExportError, to_npz, to_python};
use joulebus_predictor::{Activation, FeatureSet, LAGS, ModelCard, Network, features};
use joulebus_testkit_fleets::random;

/// Largest difference to the network in single precision, W.
const ALLOWED_W: f64 = 1e-5;
const PERIOD_S: f32 = 0.033;

/// Reads commands and readings, and prints the forecasts in mW.
const DRIVE: &str = r#"
import json, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from predictor import EnergyPredictor

asked = json.load(sys.stdin)
one, again, many = EnergyPredictor(), EnergyPredictor(sys.argv[1] + "/model.npz"), EnergyPredictor()
found = {"open": [], "corrected": [], "many": []}
one.reset(initial_power=asked["initial"])
again.reset(initial_power=asked["initial"])
many.reset(initial_power=np.full(3, asked["initial"]))
for v, w in asked["commands"]:
    found["open"].append(one.step(v, w))
    assert again.step(v, w) == found["open"][-1], "read from the archive"
    each = many.step(np.array([v, 0.0, v]), w)
    assert each.shape == (3,) and abs(each[0] - each[2]) < 1e-6, each
    found["many"].append(each[0])
one.reset(asked["initial"])
for (v, w), measured in zip(asked["commands"], asked["measured"]):
    found["corrected"].append(one.step_with_correction(v, w, float("nan") if measured is None else measured))
for refused in [lambda: one.step(float("nan"), 0.0), lambda: one.reset(float("inf")), lambda: EnergyPredictor(period_s=0.0)]:
    try:
        refused()
        sys.exit("not refused")
    except ValueError as error:
        assert "allowed" in str(error), error
json.dump(found, sys.stdout)
"#;

/// A Python with NumPy: of `tools/python.sh`, else of the system. `None` without one.
fn python() -> Option<String> {
    let named = std::env::var("JOULEBUS_PYTHON").ok();
    let found = [named, Some("python3".to_owned())].into_iter().flatten();
    let found = found.into_iter().find(|python| {
        let tried = Command::new(python).args(["-c", "import numpy"]).output();
        tried.is_ok_and(|tried| tried.status.success())
    });
    if found.is_none() {
        assert!(std::env::var_os("CI").is_none(), "no Python with NumPy; run tools/python.sh");
        eprintln!("skipped: no Python with NumPy; run tools/python.sh");
    }
    found
}

fn with(network: &Network, activation: Activation) -> Network {
    let mut parameters = network.parameters().clone();
    parameters.activation = activation;
    let card = ModelCard { step_s: Some(PERIOD_S), ..network.card().clone() };
    Network::new(parameters, card).unwrap()
}

/// The forecasts in W, step by step. `measured_w` has the readings with which they continue.
fn expected(network: &Network, commands: &[(f32, f32)], measured_w: &[Option<f32>]) -> Vec<f32> {
    let (mut lag_w, mut before) = ([3.5; LAGS], None);
    let step = |(at, (v, omega)): (usize, &(f32, f32))| {
        let row = features(*v, *omega, before, &lag_w);
        let mut forecast_w = [0.0];
        network.predict(&[row], &mut forecast_w);
        let fed_back_w = network.card().training_range.fed_back_w(forecast_w[0]);
        lag_w.copy_within(..LAGS - 1, 1);
        lag_w[0] = measured_w.get(at).copied().flatten().unwrap_or(fed_back_w);
        before = Some((*v, *omega, PERIOD_S));
        forecast_w[0]
    };
    commands.iter().enumerate().map(step).collect()
}

#[test]
fn an_exported_module_forecasts_what_the_network_does() {
    let Some(python) = python() else { return };
    let mut noise = random::Noise(5);
    let commands: Vec<(f32, f32)> = (0..60).map(|_| (noise.next_f32(), noise.next_f32())).collect();
    let measured_w: Vec<Option<f32>> =
        (0..60).map(|at| (at % 7 != 3).then(|| 3.0 + noise.next_f32())).collect();
    let milliwatt = |power_w: &Option<f32>| power_w.map(|power_w| 1e3 * f64::from(power_w));
    let asked = serde_json::json!({
        "initial": 3500.0,
        "commands": commands,
        "measured": measured_w.iter().map(milliwatt).collect::<Vec<_>>(),
    });
    for set in [FeatureSet::Full, FeatureSet::PowerOnly] {
        for activation in Activation::ALL {
            let network = with(&random::network(7, set), activation);
            let place = tempfile::tempdir().unwrap();
            std::fs::write(place.path().join("predictor.py"), to_python(&network).unwrap())
                .unwrap();
            std::fs::write(place.path().join("model.npz"), to_npz(&network).unwrap()).unwrap();
            std::fs::write(place.path().join("asked.json"), asked.to_string()).unwrap();
            let run = Command::new(&python)
                .args(["-c", DRIVE, place.path().to_str().unwrap()])
                .stdin(std::fs::File::open(place.path().join("asked.json")).unwrap())
                .output()
                .unwrap();
            assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
            let found: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
            let open = expected(&network, &commands, &[]);
            let corrected = expected(&network, &commands, &measured_w);
            for (name, expected) in [("open", &open), ("many", &open), ("corrected", &corrected)] {
                let found = found[name].as_array().unwrap();
                assert_eq!(found.len(), expected.len());
                for (step, (found, expected)) in found.iter().zip(expected).enumerate() {
                    let found_w = 1e-3 * found.as_f64().unwrap();
                    let difference_w = (found_w - f64::from(*expected)).abs();
                    assert!(
                        difference_w <= ALLOWED_W,
                        "{set:?} {activation:?} {name} step {step}: {found_w} W, expected {expected} W"
                    );
                }
            }
        }
    }
}

#[test]
fn a_network_that_reads_the_age_of_readings_is_refused() {
    let network = random::network(7, FeatureSet::Freshness);
    assert!(matches!(to_python(&network), Err(ExportError::ReadingAge)));
}

#[test]
fn a_models_name_cannot_add_code() {
    let mut card = random::network(7, FeatureSet::Full).card().clone();
    card.name = "a\"\"\"\nimport os\n@MODEL@\\".to_owned();
    let network = Network::new(random::network(7, FeatureSet::Full).parameters().clone(), card);
    let text = to_python(&network.unwrap()).unwrap();
    assert!(text.starts_with(
        "\"\"\"Forecasts of a robot's power, by the joulebus model aimportosMODEL, hash "
    ));
    assert!(!text.contains("import os\n"));
    for place in ["@NAME@", "@HASH@", "@INPUTS@", "@SHAPES@", "@MODEL@"] {
        assert!(!text.contains(place), "{place}");
    }
}

#[test]
fn the_period_is_that_of_the_training_data_or_demanded() {
    let unknown = random::network(7, FeatureSet::Full);
    let stated = with(&unknown, Activation::Relu);
    for (network, period) in [(&unknown, "None"), (&stated, "0.033")] {
        let text = to_python(network).unwrap();
        assert!(text.contains(&format!("\nPERIOD_S = {period}\n")), "{period}");
    }
}
