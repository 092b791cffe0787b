//! Training: from rows of a simulated fleet to a model file for the worker. The same seed gives the
//! same bytes on every machine.

use std::fs;

use joulebus_predictor::FeatureSet;
use joulebus_sim::training_data::{SimulatedData, dataset_from_plant};
use joulebus_train::{TrainSettings, train};

fn main() -> anyhow::Result<()> {
    // Split by robot: the rows of one robot are all in the same part.
    let dataset = dataset_from_plant(SimulatedData {
        seed: 7,
        training_robots: 8,
        validation_robots: 2,
        held_out_robots: 4,
        full_speed_robots: 0,
        ticks: 300,
    });
    // The paper's recipe trains up to 100 epochs. Three are enough for an example.
    let settings = TrainSettings {
        max_epochs: 3,
        ..TrainSettings::new("example", "simulation", FeatureSet::Full, 7)
    };
    let trained = train(&dataset, &settings, |epoch| {
        println!("epoch {}: validation loss {:.4}", epoch.number, epoch.validation_loss);
    })?;

    let scores = &trained.network.card().scores;
    println!(
        "{} forecasts of held-out robots: MAE {:.3} W, persistence {:.3} W",
        scores.rows, scores.network_mae_w, scores.persistence_mae_w,
    );
    let directory = tempfile::tempdir()?;
    let file = directory.path().join("example.safetensors");
    fs::write(&file, trained.network.to_safetensors()?)?;
    println!(
        "a model file of {} bytes, for `model = \"…\"` of a platform",
        fs::metadata(&file)?.len()
    );
    Ok(())
}
